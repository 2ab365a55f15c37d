//! Messages between coordinator and workers.

use super::collective::{read_transfers, transfers};
use super::{map_kind, micros, name, required};
use crate::collective::Transfers;
use crate::digest::Digest;
use crate::error::{WireError, truncated};
use crate::limits::{HEARTBEAT, MAX_ERROR_BYTES, MAX_MAP_BYTES, MAX_RESULT_BYTES, MAX_THREADS};
use crate::message::{
    BlobRef, DeliverHeader, FromWorker, Hello, Lease, LeaseId, MapRef, SessionKey, Task, ToWorker, WorkerId,
};
use crate::types::JobId;
use crate::wire;
use bytes::Bytes;
use gatherlight_render::photon::{EmissionRange, MapKind};
use gatherlight_render::settings::MAX_ROUNDS;
use std::time::Duration;

impl From<SessionKey> for Bytes {
    fn from(key: SessionKey) -> Self {
        Bytes::copy_from_slice(&key.0)
    }
}

impl TryFrom<&[u8]> for SessionKey {
    type Error = WireError;
    fn try_from(bytes: &[u8]) -> Result<Self, WireError> {
        let key = bytes.try_into().map_err(|_| WireError::invalid("session", "has to have 16 bytes"))?;
        Ok(SessionKey(key))
    }
}

fn range(first: u64, end: u64) -> Result<EmissionRange, WireError> {
    EmissionRange::new(first, end).ok_or_else(|| WireError::invalid("end", format!("{end} is before {first}")))
}

impl From<FromWorker> for wire::WorkerMessage {
    fn from(m: FromWorker) -> Self {
        use wire::worker_message::Kind;
        let kind = match m {
            FromWorker::Hello(h) => {
                let Hello { name, threads, memory_bytes, relay } = h;
                Kind::Hello(wire::Hello { name, threads, memory_bytes, relay: relay.map(Into::into) })
            }
            FromWorker::Heartbeat => Kind::Heartbeat(wire::Heartbeat {}),
            FromWorker::TaskFailed { lease, attempt, error } => {
                let error = truncated(&error, MAX_ERROR_BYTES).to_owned();
                Kind::TaskFailed(wire::TaskFailed { lease: lease.0, attempt, error })
            }
            FromWorker::TaskReturned { lease, attempt } => {
                Kind::TaskReturned(wire::TaskReturned { lease: lease.0, attempt })
            }
            FromWorker::Draining => Kind::Draining(wire::Draining {}),
        };
        wire::WorkerMessage { kind: Some(kind) }
    }
}

impl TryFrom<wire::WorkerMessage> for FromWorker {
    type Error = WireError;
    fn try_from(m: wire::WorkerMessage) -> Result<Self, WireError> {
        use wire::worker_message::Kind;
        Ok(match required("message.kind", m.kind)? {
            Kind::Hello(h) => {
                if h.threads == 0 || h.threads > MAX_THREADS {
                    let message = format!("{} is outside 1 … {MAX_THREADS} (MAX_THREADS)", h.threads);
                    return Err(WireError::invalid("hello.threads", message));
                }
                let name = name("hello.name", h.name)?;
                let relay = h.relay.map(TryInto::try_into).transpose()?;
                FromWorker::Hello(Hello { name, threads: h.threads, memory_bytes: h.memory_bytes, relay })
            }
            Kind::Heartbeat(_) => FromWorker::Heartbeat,
            Kind::TaskFailed(t) => FromWorker::TaskFailed {
                lease: LeaseId(t.lease),
                attempt: t.attempt,
                // It will be shown on terminals.
                error: truncated(&t.error, MAX_ERROR_BYTES).replace(|c: char| c.is_control() && c != '\n', " "),
            },
            Kind::TaskReturned(t) => FromWorker::TaskReturned { lease: LeaseId(t.lease), attempt: t.attempt },
            Kind::Draining(_) => FromWorker::Draining,
        })
    }
}

impl From<MapRef> for wire::MapRef {
    fn from(m: MapRef) -> Self {
        wire::MapRef { map: wire::MapKind::from(m.kind).into(), digest: m.digest.to_bytes(), bytes: m.bytes }
    }
}

impl TryFrom<wire::MapRef> for MapRef {
    type Error = WireError;
    fn try_from(m: wire::MapRef) -> Result<Self, WireError> {
        WireError::check_limit("map size in bytes", m.bytes, MAX_MAP_BYTES, "MAX_MAP_BYTES")?;
        Ok(MapRef { kind: map_kind(m.map)?, digest: Digest::try_from(&m.digest[..])?, bytes: m.bytes })
    }
}

fn round(round: u32) -> Result<u32, WireError> {
    if round < MAX_ROUNDS {
        return Ok(round);
    }
    Err(WireError::invalid("round", format!("{round} is outside 0 … {} (MAX_ROUNDS)", MAX_ROUNDS - 1)))
}

/// Something that workers read, of at most [`MAX_MAP_BYTES`].
fn input(what: &'static str, b: wire::Blob) -> Result<BlobRef, WireError> {
    WireError::check_limit(what, b.bytes, MAX_MAP_BYTES, "MAX_MAP_BYTES")?;
    Ok(BlobRef { digest: Digest::try_from(&b.digest[..])?, bytes: b.bytes })
}

impl From<Lease> for wire::Lease {
    fn from(l: Lease) -> Self {
        let task = match l.task {
            Task::Emission { round, map } => {
                wire::lease::Task::Emission(wire::EmissionTask { map: wire::MapKind::from(map).into(), round })
            }
            Task::Bootstrap => wire::lease::Task::Bootstrap(wire::BootstrapTask {}),
            Task::Splat { round, bootstrap } => {
                wire::lease::Task::Splat(wire::SplatTask { bootstrap: bootstrap.map(Into::into), round })
            }
            Task::Gather { round, maps, sample_map } => {
                let maps = maps.into_iter().map(Into::into).collect();
                wire::lease::Task::Gather(wire::GatherTask { maps, round, sample_map: sample_map.map(Into::into) })
            }
        };
        wire::Lease {
            lease: l.id.0,
            attempt: l.attempt,
            job: l.job.0,
            first: l.range.first,
            end: l.range.end,
            task: Some(task),
        }
    }
}

impl TryFrom<wire::Lease> for Lease {
    type Error = WireError;
    fn try_from(l: wire::Lease) -> Result<Self, WireError> {
        let task = match required("lease.task", l.task)? {
            wire::lease::Task::Emission(t) => Task::Emission { round: round(t.round)?, map: map_kind(t.map)? },
            wire::lease::Task::Bootstrap(_) => Task::Bootstrap,
            wire::lease::Task::Splat(t) => {
                let bootstrap = t.bootstrap.map(|b| input("bootstrap size in bytes", b)).transpose()?;
                Task::Splat { round: round(t.round)?, bootstrap }
            }
            wire::lease::Task::Gather(t) => {
                let limit = MapKind::ALL.len() as u64;
                WireError::check_limit("maps of a lease", t.maps.len() as u64, limit, "number of map kinds")?;
                let maps = t.maps.into_iter().map(MapRef::try_from).collect::<Result<_, _>>()?;
                let sample_map = t.sample_map.map(|b| input("sample map size in bytes", b)).transpose()?;
                Task::Gather { round: round(t.round)?, maps, sample_map }
            }
        };
        let range = range(l.first, l.end)?;
        Ok(Lease { id: LeaseId(l.lease), attempt: l.attempt, job: JobId(l.job), range, task })
    }
}

impl From<ToWorker> for wire::CoordinatorMessage {
    fn from(m: ToWorker) -> Self {
        use wire::coordinator_message::Kind;
        let kind = match m {
            ToWorker::Welcome { worker, session, heartbeat } => Kind::Welcome(wire::Welcome {
                worker: worker.0,
                session: session.into(),
                heartbeat_ms: heartbeat.as_millis() as u32,
            }),
            ToWorker::Prepare { job, scene, settings } => Kind::Prepare(wire::Prepare {
                job: job.0,
                scene: Some((&scene).into()),
                settings: Some((&*settings).into()),
            }),
            ToWorker::Lease(l) => Kind::Lease(l.into()),
            ToWorker::Revoke(lease) => Kind::Revoke(wire::Revoke { lease: lease.0 }),
            ToWorker::Forget(job) => Kind::Forget(wire::Forget { job: job.0 }),
            ToWorker::Route(route) => Kind::Route(route.into()),
        };
        wire::CoordinatorMessage { kind: Some(kind) }
    }
}

impl TryFrom<wire::CoordinatorMessage> for ToWorker {
    type Error = WireError;
    fn try_from(m: wire::CoordinatorMessage) -> Result<Self, WireError> {
        use wire::coordinator_message::Kind;
        Ok(match required("message.kind", m.kind)? {
            Kind::Welcome(w) => {
                // Never a busy loop, and never so rare that the coordinator takes us for dead.
                let heartbeat = Duration::from_millis(w.heartbeat_ms.into());
                let heartbeat = heartbeat.clamp(HEARTBEAT / 100, HEARTBEAT);
                ToWorker::Welcome { worker: WorkerId(w.worker), session: (&w.session[..]).try_into()?, heartbeat }
            }
            Kind::Prepare(p) => ToWorker::Prepare {
                job: JobId(p.job),
                scene: required("prepare.scene", p.scene)?.try_into()?,
                settings: Box::new(required("prepare.settings", p.settings)?.try_into()?),
            },
            Kind::Lease(l) => ToWorker::Lease(l.try_into()?),
            Kind::Revoke(r) => ToWorker::Revoke(LeaseId(r.lease)),
            Kind::Forget(f) => ToWorker::Forget(JobId(f.job)),
            Kind::Route(route) => ToWorker::Route(route.try_into()?),
        })
    }
}

impl From<DeliverHeader> for wire::DeliverHeader {
    fn from(h: DeliverHeader) -> Self {
        wire::DeliverHeader {
            session: h.session.into(),
            lease: h.lease.0,
            attempt: h.attempt,
            first: h.range.first,
            end: h.range.end,
            busy_micros: micros(h.busy),
            bytes: h.bytes,
            digest: h.digest.to_bytes(),
            fetched: transfers(&h.fetched),
        }
    }
}

impl TryFrom<wire::DeliverHeader> for DeliverHeader {
    type Error = WireError;
    fn try_from(h: wire::DeliverHeader) -> Result<Self, WireError> {
        WireError::check_limit("result size in bytes", h.bytes, MAX_RESULT_BYTES, "MAX_RESULT_BYTES")?;
        Ok(DeliverHeader {
            session: (&h.session[..]).try_into()?,
            lease: LeaseId(h.lease),
            attempt: h.attempt,
            range: range(h.first, h.end)?,
            busy: Duration::from_micros(h.busy_micros),
            bytes: h.bytes,
            digest: Digest::try_from(&h.digest[..])?,
            fetched: fetched(&h.fetched)?,
        })
    }
}

/// Workers receive broadcasts only.
fn fetched(sent: &[wire::Transfer]) -> Result<Transfers, WireError> {
    let fetched = read_transfers(sent)?;
    match fetched.iter().find(|(kind, _)| !kind.is_broadcast()) {
        None => Ok(fetched),
        Some((kind, _)) => Err(WireError::invalid("fetched", format!("{} is nothing that workers fetch", kind.name()))),
    }
}
