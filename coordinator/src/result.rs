//! A result as workers send it → what it holds. Runs on the compute threads.

use crate::driver::Payload;
use gatherlight_proto::WireError;
use gatherlight_proto::payload::{bootstrap, gather, light, photons};
use gatherlight_render::film::{ChannelSet, LightImage, TileGrid};
use gatherlight_render::job::{Phase, PreparedJob};
use gatherlight_render::photon::{EmissionRange, MapKind};
use std::collections::BTreeSet;
use std::sync::Arc;

/// What has to be known of a job to read its results.
#[derive(Clone, Debug)]
pub struct Shape {
    /// How the image is cut.
    pub grid: TileGrid,
    /// What each pixel holds.
    pub channels: ChannelSet,
    /// Maps whose photons carry directions.
    pub directions: BTreeSet<MapKind>,
    /// The job's light image, empty, where it has one.
    pub light: Option<Arc<LightImage>>,
}

impl Shape {
    /// That of a job.
    pub fn of(job: &PreparedJob) -> Self {
        Shape {
            grid: job.grid(),
            channels: job.channels(),
            directions: MapKind::ALL.into_iter().filter(|&k| job.photon_directions(k)).collect(),
            light: job.light_image().map(Arc::new),
        }
    }
}

/// Reads the result of the indices `range` of `phase`.
///
/// # Errors
/// When it is not what that phase gives.
pub(crate) fn read(shape: &Shape, phase: Phase, range: EmissionRange, bytes: &[u8]) -> Result<Payload, WireError> {
    let empty = shape.light.as_deref();
    Ok(match phase {
        Phase::Emission { map, .. } => {
            Payload::Photons(photons::decode_batch(bytes, range, shape.directions.contains(&map))?)
        }
        Phase::Bootstrap { .. } => Payload::Luminances(range.first, bootstrap::decode(bytes, range)?),
        Phase::SampleMap { .. } => return Err(WireError::payload("sample map", "is nothing that workers make")),
        Phase::Splat { .. } => {
            let empty = empty.ok_or_else(|| WireError::payload("light image", "is of a method that has none"))?;
            Payload::Light(light::decode(bytes, empty)?)
        }
        Phase::Gather { .. } => {
            let (tiles, light) = gather::decode(bytes, range, shape.grid, &shape.channels, empty)?;
            Payload::Tiles(tiles, light)
        }
    })
}
