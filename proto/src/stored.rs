//! What the coordinator keeps of jobs in its store, beside the bytes that workers sent.

use crate::convert::millis;
use crate::digest::Digest;
use crate::error::WireError;
use crate::message::{BlobRef, Submission};
use crate::types::{JobProgress, JobStats};
use crate::wire;
use gatherlight_render::photon::MapKind;
use prost::Message;
use std::collections::BTreeMap;
use std::time::Duration;

/// A job: enough to begin it again, and what is left of it once it has ended.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredJob {
    /// As it was submitted.
    pub submission: Submission,
    /// Who submitted it; empty: anybody.
    pub owner: String,
    /// Time of the submission since 1970.
    pub submitted: Duration,
    /// Version that computed what is kept of it.
    pub program: String,
    /// Times the coordinator was restarted amid the job.
    pub restarts: u32,
    /// Its last snapshot, once it has ended.
    pub last: Option<JobProgress>,
    /// Its image, where there is one.
    pub image: Option<BlobRef>,
}

impl StoredJob {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let stored = wire::StoredJob {
            request: Some((&self.submission).into()),
            owner: self.owner.clone(),
            submitted_ms: millis(self.submitted),
            program: self.program.clone(),
            restarts: self.restarts,
            last: self.last.as_ref().map(Into::into),
            image: self.image.map(Into::into),
        };
        stored.encode_to_vec()
    }
    /// From bytes.
    ///
    /// # Errors
    /// When they make no sense.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let stored = wire::StoredJob::decode(bytes).map_err(|e| WireError::payload("stored job", e.to_string()))?;
        Ok(StoredJob {
            submission: stored.request.ok_or(WireError::Missing("request"))?.try_into()?,
            owner: stored.owner,
            submitted: Duration::from_millis(stored.submitted_ms),
            program: stored.program,
            restarts: stored.restarts,
            last: stored.last.map(JobProgress::try_from).transpose()?,
            image: stored
                .image
                .map(|b| Ok::<_, WireError>(BlobRef { digest: Digest::try_from(&b.digest[..])?, bytes: b.bytes }))
                .transpose()?,
        })
    }
}

/// Counts over the closed rounds of a job.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StoredRounds {
    /// Counts over these rounds.
    pub stats: JobStats,
    /// Largest gather radius of each map that was built, in world units.
    pub gather_radii: BTreeMap<MapKind, f32>,
}

impl StoredRounds {
    /// As bytes.
    pub fn encode(&self) -> Vec<u8> {
        let radius =
            |(&kind, &radius): (&MapKind, &f32)| wire::StoredRadius { map: wire::MapKind::from(kind).into(), radius };
        let gather_radii = self.gather_radii.iter().map(radius).collect();
        wire::StoredRounds { stats: Some((&self.stats).into()), gather_radii }.encode_to_vec()
    }
    /// From bytes.
    ///
    /// # Errors
    /// When they make no sense.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        let stored =
            wire::StoredRounds::decode(bytes).map_err(|e| WireError::payload("stored rounds", e.to_string()))?;
        let radius = |r: wire::StoredRadius| Ok::<_, WireError>((crate::convert::map_kind(r.map)?, r.radius));
        Ok(StoredRounds {
            stats: stored.stats.ok_or(WireError::Missing("stats"))?.try_into()?,
            gather_radii: stored.gather_radii.into_iter().map(radius).collect::<Result<_, _>>()?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::message::SceneManifest;
    use crate::types::{JobId, JobState, Limits};
    use gatherlight_render::settings::RenderSettings;

    fn blob(n: u8) -> BlobRef {
        BlobRef { digest: Digest([n; 32]), bytes: u64::from(n) }
    }

    #[test]
    fn jobs_and_rounds_come_back_as_they_were() {
        let stats = JobStats { rays: 9, disputes: 2, restarts: 3, result_bytes: 7, ..JobStats::default() };
        let last = JobProgress {
            id: JobId(4),
            name: "a".into(),
            state: JobState::Failed("why".into()),
            round: 1,
            rounds: 2,
            done: 3,
            total: 4,
            rate: 0.5,
            state_elapsed: Duration::from_millis(5),
            elapsed: Duration::from_millis(6),
            workers: 0,
            stats: stats.clone(),
            result_digest: None,
            priority: -3,
            waits_for: "rain".into(),
            owner: "somebody".into(),
        };
        let job = StoredJob {
            submission: Submission {
                name: "a".into(),
                request_key: [7; 16],
                manifest: SceneManifest {
                    name: "s.glb".into(),
                    root: blob(1),
                    externals: vec![("b.bin".into(), blob(2))],
                },
                settings: RenderSettings::default(),
                limits: Limits { time: Some(Duration::from_secs(3)), error: Some(0.5) },
                priority: -3,
            },
            owner: "somebody".into(),
            submitted: Duration::from_millis(1_700_000_000_123),
            program: "0.1.0".into(),
            restarts: 3,
            last: Some(last),
            image: Some(blob(9)),
        };
        assert_eq!(StoredJob::decode(&job.encode()), Ok(job.clone()));
        let running = StoredJob { last: None, image: None, ..job };
        assert_eq!(StoredJob::decode(&running.encode()), Ok(running.clone()));
        assert!(StoredJob::decode(&running.encode()[1..]).is_err() && StoredJob::decode(&[]).is_err());
        let rounds = StoredRounds { stats, gather_radii: BTreeMap::from([(MapKind::Caustic, 0.25)]) };
        assert_eq!(StoredRounds::decode(&rounds.encode()), Ok(rounds.clone()));
    }
}
