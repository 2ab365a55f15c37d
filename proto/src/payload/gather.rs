//! Results of gather leases ↔ bytes: tiles and, where the method splats, the light image that goes with them.
//!
//! Layout: the tiles (see [`tiles`]), then the light image (see [`light`]), which is there exactly when the job has one.

use super::{light, tiles};
use crate::error::WireError;
use bytes::Bytes;
use gatherlight_render::film::{ChannelSet, LightImage, Tile, TileGrid};
use gatherlight_render::photon::EmissionRange;

/// Encodes `tiles`, each pixel with `channels` floats, and what their samples splatted.
pub fn encode(tiles: &[Tile], channels: usize, light: Option<&LightImage>) -> Bytes {
    let mut out = tiles::encode(tiles, channels);
    if let Some(light) = light {
        light::append(light, &mut out);
    }
    out.freeze()
}

/// Decodes the tiles `range` of an image cut by `grid`, and a light image like the `empty` one, where there is one.
///
/// # Errors
/// When the bytes are not exactly that; see [`tiles::decode`] and [`light::decode`].
pub fn decode(
    bytes: &[u8],
    range: EmissionRange,
    grid: TileGrid,
    channels: &ChannelSet,
    empty: Option<&LightImage>,
) -> Result<(Vec<Tile>, Option<LightImage>), WireError> {
    let (tiles, rest) = tiles::decode(bytes, range, grid, channels)?;
    let light = empty.map(|empty| light::decode(rest, empty)).transpose()?;
    if light.is_none() && !rest.is_empty() {
        return Err(WireError::payload("tiles", format!("{} bytes follow the last tile", rest.len())));
    }
    Ok((tiles, light))
}

#[cfg(test)]
mod tests {
    use super::*;
    use gatherlight_render::math::Rgb;

    const GRID: TileGrid = TileGrid { width: 16, height: 20 };
    const RANGE: EmissionRange = EmissionRange { first: 1, end: 2 };

    fn tile() -> Tile {
        Tile { index: 1, pixels: vec![0.5; 16 * 4 * 4], non_finite: 1, rays: 2 }
    }

    #[test]
    fn tiles_come_with_a_light_image_exactly_where_the_job_has_one() {
        let (empty, channels) = (LightImage::new(GRID, 1, 1.0), ChannelSet::new(&[]));
        let mut light = empty.clone();
        light.splat(0, 3, 18, Rgb::new(1.0, 2.0, 3.0));
        let with = encode(&[tile()], 4, Some(&light));
        let without = encode(&[tile()], 4, None);
        assert_eq!(decode(&with, RANGE, GRID, &channels, Some(&empty)), Ok((vec![tile()], Some(light))));
        assert_eq!(decode(&without, RANGE, GRID, &channels, None), Ok((vec![tile()], None)));
        assert!(decode(&with, RANGE, GRID, &channels, None).is_err());
        assert!(decode(&without, RANGE, GRID, &channels, Some(&empty)).is_err());
        for n in 0..with.len() {
            assert!(decode(&with[..n], RANGE, GRID, &channels, Some(&empty)).is_err(), "{n} bytes");
        }
    }
}
