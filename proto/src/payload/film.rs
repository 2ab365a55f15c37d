//! The film in the making ↔ bytes, for the coordinator's own store: what was closed of a job's rounds survives a restart.
//!
//! Layout: `GLAC`, version u32 little-endian, then the fields as bincode lays them out. It never travels, and is read back by the
//! same version only, after its digest was checked.

use crate::error::WireError;
use bincode::config::{Configuration, Fixint, Limit, LittleEndian, standard};
use gatherlight_render::film::Accumulator;

const MAGIC: [u8; 4] = *b"GLAC";
const VERSION: u32 = 1;
/// Largest film, bytes: a gibipixel with a few layers.
const MAX_BYTES: usize = 1 << 40;
const WHAT: &str = "film";

fn config() -> Configuration<LittleEndian, Fixint, Limit<MAX_BYTES>> {
    standard().with_fixed_int_encoding().with_limit::<MAX_BYTES>()
}

/// Encodes the closed rounds.
///
/// # Errors
/// When it is larger than any film may be.
pub fn encode(film: &Accumulator) -> Result<Vec<u8>, WireError> {
    let mut out = Vec::with_capacity(64 + film.bytes());
    out.extend(MAGIC);
    out.extend(VERSION.to_le_bytes());
    bincode::serde::encode_into_std_write(film, &mut out, config())
        .map_err(|e| WireError::payload(WHAT, e.to_string()))?;
    Ok(out)
}

/// Decodes what [`encode`] made; `fresh` is the job's film before its first round.
///
/// # Errors
/// When it is damaged or of another job.
pub fn decode(bytes: &[u8], fresh: &Accumulator) -> Result<Accumulator, WireError> {
    let header = [&MAGIC[..], &VERSION.to_le_bytes()].concat();
    let body =
        bytes.strip_prefix(&header[..]).ok_or_else(|| WireError::payload(WHAT, "does not start with GLAC, 1"))?;
    let (film, length): (Accumulator, usize) =
        bincode::serde::decode_from_slice(body, config()).map_err(|e| WireError::payload(WHAT, e.to_string()))?;
    if length != body.len() || !film.continues(fresh) {
        return Err(WireError::payload(WHAT, "is of another job"));
    }
    Ok(film)
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::film::{ChannelSet, LightImage, Tile, TileGrid};
    use gatherlight_render::math::Rgb;
    use gatherlight_render::settings::Layer;

    const GRID: TileGrid = TileGrid { width: 20, height: 12 };

    fn fresh(rounds: usize) -> Accumulator {
        let channels = ChannelSet::of_tiles(&[Layer::Variance, Layer::StandardError]);
        Accumulator::new(GRID, channels, vec![1; rounds]).with_blur(vec![1.0; rounds]).with_standard_error()
    }
    fn add_round(film: &mut Accumulator, value: f32) {
        for index in 0..GRID.len() {
            let rect = GRID.rect(index).unwrap();
            let pixels = vec![value * (1.0 + index as f32); (rect.width * rect.height) as usize * 7];
            film.insert(film.closed_rounds(), &Tile { index, pixels, non_finite: 0, rays: 1 }).unwrap();
        }
        let mut light = LightImage::new(GRID, 2, 1.0);
        light.splat(1, 3, 4, Rgb::new(value, 0.5, 1e-3));
        film.close(Some(&light));
    }

    #[test]
    fn rounds_go_on_with_the_same_bits() {
        let mut whole = fresh(6);
        [0.25, 0.5, 0.125].into_iter().for_each(|v| add_round(&mut whole, v));
        let mut restored = decode(&encode(&whole).unwrap(), &fresh(6)).unwrap();
        for film in [&mut whole, &mut restored] {
            [0.75, 0.1, 0.3].into_iter().for_each(|v| add_round(film, v));
        }
        assert_eq!((whole.noise(), whole.bias()), (restored.noise(), restored.bias()));
        assert!(whole.noise().is_some());
        assert_eq!(whole.finish().pixels, restored.finish().pixels);
    }

    #[test]
    fn damage_and_other_jobs_are_errors() {
        let bytes = encode(&fresh(6)).unwrap();
        assert!(decode(&bytes, &fresh(6)).is_ok());
        assert!(decode(&bytes, &fresh(7)).is_err());
        let other = Accumulator::new(TileGrid { width: 21, height: 12 }, ChannelSet::new(&[]), vec![1; 6]);
        assert!(decode(&bytes, &other).is_err());
        for length in 0..64 {
            assert!(decode(&bytes[..length], &fresh(6)).is_err());
        }
        assert!(decode(&[&bytes[..], &[0]].concat(), &fresh(6)).is_err());
    }
}
