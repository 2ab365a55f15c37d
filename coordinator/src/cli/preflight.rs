//! What is known before any work: the plan and the warnings.

use super::error::CliError;
use super::format::bytes;
use super::progress::warn;
use super::scene::Loaded;
use crate::report;
use crate::schedule::job::closes_rounds;
use gatherlight_render::auto::Choice;
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::plan::{EmissionPlan, Plan, PlanEntry, Saving};
use serde_json::{Value, json};

/// What a scene and its settings will lead to.
pub(super) struct Preflight {
    /// Digest of the scene.
    pub(super) digest: String,
    /// What is computed and what is left out, with the reason: one line each.
    pub(super) plan: Vec<String>,
    /// The same with what leaving out saves, and below each line what it rests on.
    details: Vec<(String, Vec<String>)>,
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
            plan: std::iter::once(method.clone()).chain(report::plan_lines(job.plan())).collect(),
            details: std::iter::once((method, Vec::new())).chain(details(job.plan())).collect(),
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

    /// The plan as it is printed; with `explain` also what each line rests on.
    pub(super) fn text(&self, explain: bool) -> String {
        let mut text = String::new();
        for (line, evidence) in &self.details {
            text.push_str(&format!("{line}\n"));
            evidence.iter().filter(|_| explain).for_each(|e| text.push_str(&format!("             {e}\n")));
        }
        text + &self.costs
    }
}

/// The lines of the plan with what leaving out saves, and the evidence of each.
fn details(plan: &Plan) -> Vec<(String, Vec<String>)> {
    let groups = report::plan_groups(plan);
    let line = |group: &[PlanEntry]| {
        let sum = |bytes: fn(&Saving) -> u64| group.iter().map(|e| bytes(&e.saves)).sum::<u64>();
        let (wire, memory) = (sum(|s| s.wire_bytes), sum(|s| s.memory_bytes));
        let mut saved: Vec<String> = group.iter().map(|e| e.saves.work.clone()).filter(|w| !w.is_empty()).collect();
        saved.extend((wire > 0).then(|| format!("{} sent", bytes(wire))));
        saved.extend((memory > 0).then(|| format!("{} of memory", bytes(memory))));
        let saved = if saved.is_empty() { String::new() } else { format!("; saves {}", saved.join(", ")) };
        let evidence = group.iter().flat_map(|e| e.evidence.iter().cloned()).collect();
        (format!("{}{saved}", report::plan_line(group)), evidence)
    };
    groups.map(line).collect()
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
    let entries: Vec<Value> = plan.entries.iter().map(entry_json).collect();
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

fn entry_json(e: &PlanEntry) -> Value {
    json!({
        "what": e.what,
        "kept": e.kept,
        "reason": e.reason,
        "saves": {
            "wire_bytes": e.saves.wire_bytes,
            "memory_bytes": e.saves.memory_bytes,
            "work": e.saves.work,
        },
        "evidence": e.evidence,
    })
}

fn phase_json(phase: &Phase) -> Value {
    match phase {
        Phase::Emission { round, map, paths } => {
            json!({ "phase": "emission", "round": round, "map": map.name(), "paths": paths })
        }
        Phase::Bootstrap { paths } => json!({ "phase": "bootstrap", "paths": paths }),
        Phase::SampleMap { round } => json!({ "phase": "sample map", "round": round }),
        Phase::Splat { round, units } => json!({ "phase": "splat", "round": round, "units": units }),
        Phase::Gather { round, tiles } => json!({ "phase": "gather", "round": round, "tiles": tiles }),
    }
}
