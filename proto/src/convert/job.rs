//! What clients see of jobs and workers.

use super::collective::{read_transfers, transfers};
use super::{map_kind, required};
use crate::digest::Digest;
use crate::error::{WireError, truncated};
use crate::limits::{MAX_ERROR_BYTES, MAX_NAME_BYTES, MAX_PRIORITY, MAX_TIME_LIMIT};
use crate::message::Submission;
use crate::types::{JobId, JobProgress, JobState, JobStats, Limit, Limits, MapStats, NonFinite, WorkerInfo};
use crate::wire;
use gatherlight_render::film::light_image::Mutations;
use gatherlight_render::film::{Bias, Noise};
use gatherlight_render::photon::MapKind;
use std::time::Duration;

pub(crate) fn millis(d: Duration) -> u64 {
    u64::try_from(d.as_millis()).unwrap_or(u64::MAX)
}

pub(crate) fn micros(d: Duration) -> u64 {
    u64::try_from(d.as_micros()).unwrap_or(u64::MAX)
}

fn cut(text: &str, limit: usize) -> String {
    truncated(text, limit).to_owned()
}

/// State, map and error as the wire has them.
fn state_fields(state: &JobState) -> (wire::JobState, wire::MapKind, String) {
    use wire::JobState as W;
    let none = wire::MapKind::Unspecified;
    match state {
        JobState::Waiting => (W::Waiting, none, String::new()),
        JobState::Emission(map) => (W::Emission, (*map).into(), String::new()),
        JobState::Merge(map) => (W::Merge, (*map).into(), String::new()),
        JobState::Broadcast => (W::Broadcast, none, String::new()),
        JobState::Bootstrap => (W::Bootstrap, none, String::new()),
        JobState::Splat => (W::Splat, none, String::new()),
        JobState::Gather => (W::Gather, none, String::new()),
        JobState::Assemble => (W::Assemble, none, String::new()),
        JobState::Done => (W::Done, none, String::new()),
        JobState::Failed(error) => (W::Failed, none, cut(error, MAX_ERROR_BYTES)),
        JobState::Cancelled => (W::Cancelled, none, String::new()),
    }
}

fn state(job: &wire::Job) -> Result<JobState, WireError> {
    use wire::JobState as W;
    Ok(match W::try_from(job.state) {
        Ok(W::Waiting) => JobState::Waiting,
        Ok(W::Emission) => JobState::Emission(map_kind(job.map)?),
        Ok(W::Merge) => JobState::Merge(map_kind(job.map)?),
        Ok(W::Broadcast) => JobState::Broadcast,
        Ok(W::Bootstrap) => JobState::Bootstrap,
        Ok(W::Splat) => JobState::Splat,
        Ok(W::Gather) => JobState::Gather,
        Ok(W::Assemble) => JobState::Assemble,
        Ok(W::Done) => JobState::Done,
        Ok(W::Failed) => JobState::Failed(cut(&job.error, MAX_ERROR_BYTES)),
        Ok(W::Cancelled) => JobState::Cancelled,
        Ok(W::Unspecified) | Err(_) => {
            return Err(WireError::invalid("job.state", format!("{} is unknown here", job.state)));
        }
    })
}

impl From<&JobProgress> for wire::Job {
    fn from(p: &JobProgress) -> Self {
        let (state, map, error) = state_fields(&p.state);
        wire::Job {
            job: p.id.0,
            name: cut(&p.name, MAX_NAME_BYTES),
            state: state.into(),
            map: map.into(),
            error,
            done: p.done,
            total: p.total,
            rate_per_second: p.rate,
            state_elapsed_ms: millis(p.state_elapsed),
            elapsed_ms: millis(p.elapsed),
            workers: p.workers,
            stats: Some((&p.stats).into()),
            result_digest: p.result_digest.map(Digest::to_bytes).unwrap_or_default(),
            round: p.round,
            rounds: p.rounds,
            priority: p.priority,
            waits_for: cut(&p.waits_for, MAX_ERROR_BYTES),
            owner: cut(&p.owner, MAX_NAME_BYTES),
        }
    }
}

impl TryFrom<wire::Job> for JobProgress {
    type Error = WireError;
    fn try_from(j: wire::Job) -> Result<Self, WireError> {
        let state = state(&j)?;
        if !j.rate_per_second.is_finite() || j.rate_per_second < 0.0 {
            return Err(WireError::invalid("job.rate_per_second", "is no rate"));
        }
        let result_digest = match &j.result_digest[..] {
            [] => None,
            bytes => Some(Digest::try_from(bytes)?),
        };
        Ok(JobProgress {
            id: JobId(j.job),
            name: cut(&j.name, MAX_NAME_BYTES),
            state,
            done: j.done,
            total: j.total,
            rate: j.rate_per_second,
            state_elapsed: Duration::from_millis(j.state_elapsed_ms),
            elapsed: Duration::from_millis(j.elapsed_ms),
            workers: j.workers,
            stats: required("job.stats", j.stats)?.try_into()?,
            result_digest,
            round: j.round,
            rounds: j.rounds,
            priority: j.priority,
            waits_for: cut(&j.waits_for, MAX_ERROR_BYTES),
            owner: cut(&j.owner, MAX_NAME_BYTES),
        })
    }
}

impl From<&JobStats> for wire::JobStats {
    fn from(s: &JobStats) -> Self {
        let map = |m: &MapStats| wire::MapStats {
            map: wire::MapKind::from(m.kind).into(),
            emitted_count: m.emitted_count,
            emitted_total: m.emitted_total,
            stored_count: m.stored_count,
            bytes: m.bytes,
        };
        wire::JobStats {
            maps: s.maps.iter().map(map).collect(),
            rays: s.rays,
            non_finite: (s.non_finite.total() > 0).then(|| {
                let NonFinite { samples, splats, photons } = s.non_finite;
                wire::NonFinite { samples, splats, photons }
            }),
            gather_radius: s.gather_radius,
            k: s.k,
            busy_ms: millis(s.busy),
            workers: s.workers,
            workers_lost: s.workers_lost,
            retried_leases: s.retried_leases,
            repeated_leases: s.repeated_leases,
            result_bytes: s.result_bytes,
            broadcast_bytes: s.broadcast_bytes,
            rounds_done: s.rounds_done,
            units_done: s.units_done,
            ended_by: match s.ended_by {
                None => wire::Limit::Unspecified,
                Some(Limit::Time) => wire::Limit::Time,
                Some(Limit::Error) => wire::Limit::Error,
            }
            .into(),
            mutations: (s.mutations != Mutations::default()).then(|| {
                let Mutations { large, large_accepted, small, small_accepted, .. } = s.mutations;
                wire::Mutations { large, large_accepted, small, small_accepted }
            }),
            standard_error: s.noise.map(|n| n.standard_error),
            relative_error: s.noise.map(|n| n.relative).filter(|r| r.is_finite()),
            bias: s.bias.map(|b| b.absolute),
            relative_bias: s.bias.map(|b| b.relative),
            disputes: s.disputes,
            restarts: s.restarts,
            transfers: transfers(&s.transfers),
        }
    }
}

impl TryFrom<wire::JobStats> for JobStats {
    type Error = WireError;
    fn try_from(s: wire::JobStats) -> Result<Self, WireError> {
        let limit = MapKind::ALL.len() as u64;
        WireError::check_limit("maps of a job", s.maps.len() as u64, limit, "number of map kinds")?;
        let map = |m: wire::MapStats| {
            Ok::<_, WireError>(MapStats {
                kind: map_kind(m.map)?,
                emitted_count: m.emitted_count,
                emitted_total: m.emitted_total,
                stored_count: m.stored_count,
                bytes: m.bytes,
            })
        };
        Ok(JobStats {
            maps: s.maps.into_iter().map(map).collect::<Result<_, _>>()?,
            rays: s.rays,
            non_finite: s.non_finite.map_or_else(NonFinite::default, |n| NonFinite {
                samples: n.samples,
                splats: n.splats,
                photons: n.photons,
            }),
            mutations: s.mutations.map_or_else(Mutations::default, |m| Mutations {
                large: m.large,
                large_accepted: m.large_accepted,
                small: m.small,
                small_accepted: m.small_accepted,
                large_luminance: 0,
                large_luminance_squared: 0,
            }),
            gather_radius: s.gather_radius,
            k: s.k,
            busy: Duration::from_millis(s.busy_ms),
            workers: s.workers,
            workers_lost: s.workers_lost,
            retried_leases: s.retried_leases,
            repeated_leases: s.repeated_leases,
            result_bytes: s.result_bytes,
            broadcast_bytes: s.broadcast_bytes,
            rounds_done: s.rounds_done,
            units_done: s.units_done,
            ended_by: match wire::Limit::try_from(s.ended_by) {
                Ok(wire::Limit::Unspecified) => None,
                Ok(wire::Limit::Time) => Some(Limit::Time),
                Ok(wire::Limit::Error) => Some(Limit::Error),
                Err(_) => return Err(WireError::invalid("stats.ended_by", format!("{} is unknown here", s.ended_by))),
            },
            noise: s
                .standard_error
                .map(|standard_error| Noise { standard_error, relative: s.relative_error.unwrap_or(f64::INFINITY) }),
            bias: s.bias.map(|absolute| Bias { absolute, relative: s.relative_bias.unwrap_or(f64::INFINITY) }),
            disputes: s.disputes,
            restarts: s.restarts,
            transfers: read_transfers(&s.transfers)?,
        })
    }
}

impl From<Limits> for wire::Limits {
    fn from(l: Limits) -> Self {
        wire::Limits { time_ms: l.time.map(millis), error: l.error }
    }
}

impl TryFrom<wire::Limits> for Limits {
    type Error = WireError;
    fn try_from(l: wire::Limits) -> Result<Self, WireError> {
        let time = l.time_ms.map(Duration::from_millis);
        if time.is_some_and(|t| t.is_zero() || t > MAX_TIME_LIMIT) {
            let most = MAX_TIME_LIMIT.as_millis();
            return Err(WireError::invalid("limits.time_ms", format!("has to be 1 … {most} (MAX_TIME_LIMIT)")));
        }
        if l.error.is_some_and(|e| !(e.is_finite() && e > 0.0)) {
            return Err(WireError::invalid("limits.error", "has to be above 0"));
        }
        Ok(Limits { time, error: l.error })
    }
}

impl From<&WorkerInfo> for wire::Worker {
    fn from(w: &WorkerInfo) -> Self {
        wire::Worker {
            worker: w.id,
            name: cut(&w.name, MAX_NAME_BYTES),
            threads: w.threads,
            memory_bytes: w.memory_bytes,
            state: w.state.clone(),
            leases: w.leases,
            completed: w.completed,
            last_heard_ms: millis(w.last_heard),
            joined_ms: millis(w.joined),
        }
    }
}

impl From<wire::Worker> for WorkerInfo {
    fn from(w: wire::Worker) -> Self {
        WorkerInfo {
            id: w.worker,
            name: cut(&w.name, MAX_NAME_BYTES),
            threads: w.threads,
            memory_bytes: w.memory_bytes,
            state: cut(&w.state, MAX_NAME_BYTES),
            leases: w.leases,
            completed: w.completed,
            last_heard: Duration::from_millis(w.last_heard_ms),
            joined: Duration::from_millis(w.joined_ms),
        }
    }
}

impl From<&Submission> for wire::SubmitRequest {
    fn from(s: &Submission) -> Self {
        wire::SubmitRequest {
            name: s.name.clone(),
            scene: Some((&s.manifest).into()),
            settings: Some((&s.settings).into()),
            request_key: s.request_key.to_vec().into(),
            limits: Some(s.limits.into()),
            priority: s.priority,
        }
    }
}

impl TryFrom<wire::SubmitRequest> for Submission {
    type Error = WireError;
    fn try_from(r: wire::SubmitRequest) -> Result<Self, WireError> {
        let request_key =
            r.request_key[..].try_into().map_err(|_| WireError::invalid("request_key", "has to have 16 bytes"))?;
        Ok(Submission {
            // It will be shown on terminals.
            name: cut(&r.name, MAX_NAME_BYTES).replace(char::is_control, " "),
            request_key,
            manifest: required("scene", r.scene)?.try_into()?,
            settings: required("settings", r.settings)?.try_into()?,
            limits: r.limits.map(Limits::try_from).transpose()?.unwrap_or_default(),
            priority: r.priority.clamp(-MAX_PRIORITY, MAX_PRIORITY),
        })
    }
}
