//! What is known before any work: the plan and the warnings.

use super::error::CliError;
use super::format::bytes;
use super::progress::warn;
use crate::report;
use crate::schedule::job::closes_rounds;
use crate::types::WorkerInfo;
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
    /// Memory that each worker of a cluster needs, in bytes.
    pub(super) worker_bytes: u64,
    /// What a user should know.
    pub(super) warnings: Vec<String>,
    /// Whether it has several rounds: a limit can end it between them, and its error is known by comparing them.
    pub(super) has_rounds: bool,
}

impl Preflight {
    /// What a job by the method of `choice` will lead to.
    pub(super) fn of(job: &PreparedJob, choice: &Choice) -> Self {
        let method = format!("method: {} — {}", choice.method.name(), choice.reason);
        Preflight {
            digest: job.scene_digest().to_string(),
            plan: std::iter::once(method.clone()).chain(report::plan_lines(job.plan())).collect(),
            details: std::iter::once((method, Vec::new())).chain(details(job.plan())).collect(),
            costs: costs(job.plan()),
            worker_bytes: job.plan().worker_bytes,
            warnings: job.warnings().to_vec(),
            has_rounds: closes_rounds(&job.phases()),
        }
    }

    /// Prints the warnings.
    ///
    /// # Errors
    /// With `strict` a warning is an error.
    pub(super) fn report_warnings(&self, strict: bool) -> Result<(), CliError> {
        report_warnings(&self.warnings, strict)
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

/// Prints warnings.
///
/// # Errors
/// With `strict` a warning is an error.
pub(super) fn report_warnings(warnings: &[String], strict: bool) -> Result<(), CliError> {
    if strict && !warnings.is_empty() {
        let all = warnings.join("; ");
        return Err(CliError::Failed(format!("{all}; without --strict this is only a warning")));
    }
    warnings.iter().for_each(|w| warn(w));
    Ok(())
}

/// What is wrong with a cluster none of whose workers has the memory that each one needs; nothing is, where there is none yet.
pub(super) fn lacks_memory(needed: u64, workers: &[WorkerInfo]) -> Option<String> {
    let most = workers.iter().map(|w| w.memory_bytes).max().filter(|&most| most < needed)?;
    Some(format!(
        "each worker needs about {}, and none of the {} that are there may use more than {}: the job waits for one with a \
         larger --memory; fewer photons need less, and --method progressive traces them in rounds",
        bytes(needed),
        workers.len(),
        bytes(most)
    ))
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
        "; on a cluster each worker needs {} (its --memory) and the coordinator {}",
        bytes(plan.worker_bytes),
        bytes(plan.coordinator_bytes)
    ));
    if plan.broadcast_bytes > 0 {
        text.push_str(&format!(", {} of maps sent to each worker", bytes(plan.broadcast_bytes)));
    }
    text
}

/// The plan for scripts.
pub(super) fn plan_json(job: &PreparedJob, choice: &Choice) -> Value {
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    fn worker(memory_bytes: u64) -> WorkerInfo {
        let (name, state, time) = (String::new(), String::new(), Duration::ZERO);
        WorkerInfo {
            id: 1,
            name,
            threads: 1,
            memory_bytes,
            state,
            leases: 0,
            completed: 0,
            last_heard: time,
            joined: time,
        }
    }

    #[test]
    fn a_cluster_without_a_large_enough_worker_is_said_so() {
        assert_eq!(lacks_memory(2 << 30, &[worker(1 << 30), worker(2 << 30)]), None);
        assert_eq!(lacks_memory(2 << 30, &[]), None);
        let text = lacks_memory(2 << 30, &[worker(1 << 30), worker(1 << 20)]).expect("is too small");
        assert!(text.contains("2.00 GiB") && text.contains("1.00 GiB") && text.contains("none of the 2"), "{text}");
    }
}
