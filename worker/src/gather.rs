//! Gather and splat leases → tiles and light images as bytes. Runs on the compute threads.

use crate::error::TaskError;
use bytes::Bytes;
use gatherlight_proto::payload::{gather, light};
use gatherlight_render::film::LightImage;
use gatherlight_render::job::{Inputs, PreparedJob};
use gatherlight_render::photon::EmissionRange;
use rayon::prelude::*;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Renders the tiles of `range` of `round`, in parallel, and encodes them in order, with what their samples splatted;
/// also returns the time it took.
pub fn compute(job: &PreparedJob, inputs: &Inputs, round: u32, range: EmissionRange) -> (Bytes, Duration) {
    let begun = Instant::now();
    // Tile numbers are 32 bits wide; a coordinator that asks for others gets tiles that it will refuse.
    let indices = range.first.min(u64::from(u32::MAX)) as u32..range.end.min(u64::from(u32::MAX)) as u32;
    let lights = Lights::default();
    let render = |tile| {
        let mut light = lights.take().or_else(|| job.light_image());
        let rendered = job.gather(inputs, round, tile, light.as_mut());
        lights.put(light);
        rendered
    };
    // One tile at a time for each thread: neighbouring tiles differ much in cost.
    let rendered: Vec<_> = indices.into_par_iter().with_max_len(1).map(render).collect();
    // A lease without tiles still says that nothing was splatted.
    let light = lights.sum().or_else(|| job.light_image());
    (gather::encode(&rendered, job.channels().len(), light.as_ref()), begun.elapsed())
}

/// Computes units `range` of the splat phase of `round` and encodes their light image; also returns the time it took.
///
/// # Errors
/// When the method has no light image.
pub fn compute_splat(
    job: &PreparedJob,
    inputs: &Inputs,
    round: u32,
    range: EmissionRange,
) -> Result<(Bytes, Duration), TaskError> {
    let begun = Instant::now();
    let mut image = job.light_image().ok_or(TaskError::NoLightImage)?;
    job.splat(inputs, round, range, &mut image);
    Ok((light::encode(&image), begun.elapsed()))
}

/// Light images that compute threads splat onto: as many as are used at once. Which tiles share one does not matter,
/// since their sum is exact.
#[derive(Default)]
struct Lights {
    free: Mutex<Vec<LightImage>>,
}

impl Lights {
    fn take(&self) -> Option<LightImage> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner).pop()
    }
    fn put(&self, light: Option<LightImage>) {
        self.free.lock().unwrap_or_else(PoisonError::into_inner).extend(light);
    }
    /// Their sum, if there is any.
    fn sum(self) -> Option<LightImage> {
        let images = self.free.into_inner().unwrap_or_else(PoisonError::into_inner);
        images.into_iter().reduce(|mut sum, image| {
            // All are of one job, so they fit.
            let added = sum.add(&image);
            debug_assert_eq!(added, Ok(()));
            sum
        })
    }
}
