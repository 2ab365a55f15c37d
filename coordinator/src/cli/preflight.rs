//! What is known before any work: the plan and the warnings.

use super::error::CliError;
use super::format::bytes;
use super::progress::warn;
use super::scene::Loaded;
use crate::report;
use crate::schedule::job::closes_rounds;
use gatherlight_render::auto::Choice;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::plan::{EmissionPlan, Plan};
use serde_json::{Value, json};

/// What a scene and its settings will lead to.
pub(super) struct Preflight {
    /// Digest of the scene.
    pub(super) digest: String,
    /// What is computed and what is left out, with the reason: one line each.
    pub(super) plan: Vec<String>,
    /// Expected memory and traffic, for people.
    pub(super) costs: String,
    /// What a user should know.
    pub(super) warnings: Vec<String>,
    /// The plan for scripts.
    pub(super) json: Value,
    /// Whether it has several rounds: a limit can end it between them, and its error is known by comparing them.
    pub(super) has_rounds: bool,
}

impl Preflight {
    /// Imports and builds the scene and makes the plan.
    ///
    /// # Errors
    /// When the scene or a setting makes no sense.
    pub(super) fn new(loaded: &Loaded) -> Result<Self, CliError> {
        Ok(Preflight::of(&PreparedJob::prepare(&loaded.bundle, &loaded.settings)?, &loaded.choice))
    }

    /// The same of a job that is prepared already, by the method of `choice`.
    pub(super) fn of(job: &PreparedJob, choice: &Choice) -> Self {
        let phases = job.phases();
        let method = format!("method: {} — {}", choice.method.name(), choice.reason);
        Preflight {
            digest: job.scene_digest().to_string(),
            plan: std::iter::once(method).chain(report::plan_lines(job.plan())).collect(),
            costs: costs(job.plan()),
            warnings: job.warnings().to_vec(),
            json: plan_json(job, choice),
            has_rounds: closes_rounds(&phases),
        }
    }

    /// Prints the warnings.
    ///
    /// # Errors
    /// With `strict` a warning is an error.
    pub(super) fn report_warnings(&self, strict: bool) -> Result<(), CliError> {
        if strict && !self.warnings.is_empty() {
            let all = self.warnings.join("; ");
            return Err(CliError::Failed(format!("{all}; without --strict this is only a warning")));
        }
        self.warnings.iter().for_each(|w| warn(w));
        Ok(())
    }

    /// The plan as it is printed.
    pub(super) fn text(&self) -> String {
        format!("{}\n{}", self.plan.join("\n"), self.costs)
    }
}

fn costs(plan: &Plan) -> String {
    let mut text = format!("peak memory about {} in one process", bytes(plan.single_process_bytes));
    text.push_str(&format!(
        "; on a cluster {} a worker and {} the coordinator",
        bytes(plan.worker_bytes),
        bytes(plan.coordinator_bytes)
    ));
    if plan.broadcast_bytes > 0 {
        text.push_str(&format!(", {} of maps sent to each worker", bytes(plan.broadcast_bytes)));
    }
    text
}

fn plan_json(job: &PreparedJob, choice: &Choice) -> Value {
    let plan = job.plan();
    let entries: Vec<Value> =
        plan.entries.iter().map(|e| json!({ "what": e.what, "kept": e.kept, "reason": e.reason })).collect();
    let emission = |e: &Option<EmissionPlan>| {
        e.as_ref().map(|e| json!({ "paths": e.paths, "expected_stored": e.expected_stored }))
    };
    json!({
        "method": { "name": choice.method.name(), "reason": choice.reason },
        "phases": job.phases().iter().map(phase_json).collect::<Vec<_>>(),
        "entries": entries,
        "global": emission(&plan.global),
        "caustic": emission(&plan.caustic),
        "single_process_bytes": plan.single_process_bytes,
        "worker_bytes": plan.worker_bytes,
        "coordinator_bytes": plan.coordinator_bytes,
        "broadcast_bytes": plan.broadcast_bytes,
    })
}

fn phase_json(phase: &Phase) -> Value {
    match phase {
        Phase::Emission { round, map, paths } => {
            json!({ "phase": "emission", "round": round, "map": map.name(), "paths": paths })
        }
        Phase::Bootstrap { paths } => json!({ "phase": "bootstrap", "paths": paths }),
        Phase::Splat { round, units } => json!({ "phase": "splat", "round": round, "units": units }),
        Phase::Gather { round, tiles } => json!({ "phase": "gather", "round": round, "tiles": tiles }),
    }
}
