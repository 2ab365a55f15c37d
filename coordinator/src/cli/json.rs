//! Jobs and workers as JSON; units are the last part of a name.

use crate::report::stats_json;
use crate::types::{JobProgress, JobState, WorkerInfo};
use serde_json::{Value, json};

/// One snapshot of a job.
pub(super) fn job(p: &JobProgress) -> Value {
    let (map, error) = match &p.state {
        JobState::Emission(map) | JobState::Merge(map) => (Some(map.name()), None),
        JobState::Failed(reason) => (None, Some(reason.as_str())),
        _ => (None, None),
    };
    json!({
        "id": p.id.to_string(),
        "name": p.name,
        "owner": Some(&p.owner).filter(|o| !o.is_empty()),
        "state": p.state.name(),
        "map": map,
        "error": error,
        "round": p.round,
        "rounds": p.rounds,
        "done": p.done,
        "total": p.total,
        "rate_per_s": p.rate,
        "state_elapsed_s": p.state_elapsed.as_secs_f64(),
        "elapsed_s": p.elapsed.as_secs_f64(),
        "workers": p.workers,
        "priority": p.priority,
        "waits_for": Some(&p.waits_for).filter(|w| !w.is_empty()),
        "result_digest": p.result_digest.as_ref().map(ToString::to_string),
        "stats": stats_json(&p.stats),
    })
}

/// One worker.
pub(super) fn worker(w: &WorkerInfo) -> Value {
    json!({
        "id": w.id,
        "name": w.name,
        "threads": w.threads,
        "memory_bytes": w.memory_bytes,
        "state": w.state,
        "leases": w.leases,
        "completed": w.completed,
        "last_heard_s": w.last_heard.as_secs_f64(),
        "joined_s": w.joined.as_secs_f64(),
    })
}
