//! A whole job computed here, phase by phase, without a cluster: for measurements that look at every round.

use crate::film::{Accumulator, LightImage, Tile};
use crate::integrator::Bootstrap;
use crate::job::{Inputs, Phase, PreparedJob};
use crate::photon::EmissionRange;
use rayon::prelude::*;
use std::sync::Arc;

/// What was computed.
#[derive(Clone, Debug)]
pub struct Run {
    /// The closed rounds.
    pub film: Accumulator,
    /// Samples, splats and photons that were not finite.
    pub non_finite: u64,
}

/// Computes the phases of `job` in order, on the current rayon pool. `goes_on` is asked after each round; after the last one its
/// answer does not matter. The bits are those of a cluster that ends after the same round.
pub fn run(job: &PreparedJob, mut goes_on: impl FnMut(&Accumulator) -> bool) -> Run {
    let mut run = Run { film: job.accumulator(), non_finite: 0 };
    let mut inputs = Inputs::default();
    for phase in job.phases() {
        let light = match phase {
            Phase::Emission { round, map, paths } => {
                let batch = job.emit(round, map, EmissionRange { first: 0, end: paths });
                run.non_finite += batch.non_finite;
                let map = Arc::new(job.build_map(map, batch));
                run.film.add_map_error(job.map_error(&map));
                inputs.maps.insert(map);
                continue;
            }
            Phase::Bootstrap { paths } => {
                let weights = job.bootstrap(EmissionRange { first: 0, end: paths });
                let bootstrap = Bootstrap::new(weights);
                run.non_finite += bootstrap.non_finite();
                inputs.bootstrap = Some(Arc::new(bootstrap));
                continue;
            }
            Phase::SampleMap { .. } => {
                inputs.sample_map = run.film.sample_map().cloned().map(Arc::new);
                continue;
            }
            Phase::Splat { round, units } => {
                let mut light = job.light_image();
                if let Some(light) = &mut light {
                    job.splat(&inputs, round, EmissionRange { first: 0, end: units }, light);
                }
                light
            }
            Phase::Gather { round, tiles } => {
                let (tiles, light) = gather(job, &inputs, round, tiles);
                for tile in &tiles {
                    run.non_finite += tile.non_finite;
                    let inserted = run.film.insert(round, tile);
                    debug_assert_eq!(inserted, Ok(()), "tiles come once, in rounds");
                }
                light
            }
        };
        run.non_finite += light.as_ref().map_or(0, LightImage::non_finite);
        job.close(&mut run.film, light.as_ref(), inputs.bootstrap.as_deref());
        if !goes_on(&run.film) {
            break;
        }
    }
    run
}

/// All tiles of a round, and the sum of what they splatted.
fn gather(job: &PreparedJob, inputs: &Inputs, round: u32, tiles: u32) -> (Vec<Tile>, Option<LightImage>) {
    let tile = |t| {
        let mut own = job.light_image();
        (job.gather(inputs, round, t, own.as_mut()), own)
    };
    let rendered: Vec<_> = (0..tiles).into_par_iter().with_max_len(1).map(tile).collect();
    let mut light = job.light_image();
    let mut images = Vec::with_capacity(rendered.len());
    for (tile, own) in rendered {
        if let (Some(light), Some(own)) = (light.as_mut(), &own) {
            // Of one job, so never mismatched.
            let _ = light.add(own);
        }
        images.push(tile);
    }
    (images, light)
}
