//! Rounds and blocks by hand.

use super::*;
use crate::math::Rgb;

const GRID: TileGrid = TileGrid { width: 20, height: 5 };

fn tile(index: u32, channels: &ChannelSet, value: impl Fn(usize) -> f32) -> Tile {
    let rect = GRID.rect(index).unwrap();
    let n = (rect.width * rect.height) as usize * channels.len();
    Tile { index, pixels: (0..n).map(|i| value(i % channels.len())).collect(), non_finite: 0, rays: 0 }
}

/// A round whose every pixel has these channels.
fn round(a: &mut Accumulator, number: u32, pixel: &[f32], light: Option<&LightImage>) {
    let channels = a.film.channels.clone();
    for t in [1, 0] {
        assert!(!a.is_round_complete());
        a.insert(number, &tile(t, &channels, |c| pixel[c])).unwrap();
    }
    assert!(a.is_round_complete());
    a.close(light);
}

#[test]
fn rounds_are_averaged_and_hits_weigh() {
    let channels = ChannelSet::new(&[Layer::Depth, Layer::Variance, Layer::Samples]);
    let mut a = Accumulator::new(GRID, channels, vec![1; 2]);
    // Colour 1 with a hit at depth 5, then colour 3 without one.
    round(&mut a, 0, &[1.0, 1.0, 1.0, 1.0, 5.0, 0.0, 0.0, 0.0, 1.0], None);
    assert_eq!(a.noise(), None);
    round(&mut a, 1, &[3.0, 3.0, 3.0, 0.0, f32::INFINITY, 0.0, 0.0, 0.0, 1.0], None);
    assert_eq!((a.closed_rounds(), a.samples()), (2, 2));
    // The variance of two samples is 2, that of their mean 1: e² = 1/4, and e²/(1 + e²) = 1/5.
    let noise = a.noise().unwrap();
    assert!(noise.standard_error == 1.0 && (noise.relative - 0.2f64.sqrt()).abs() < 1e-15, "{noise:?}");
    let film = a.clone().with_standard_error().finish();
    assert_eq!(film.pixel(19, 4)[9..], [1.0; 3]);
    let film = a.finish();
    assert!(film.is_complete());
    assert_eq!(film.pixel(19, 4), [2.0, 2.0, 2.0, 0.5, 5.0, 2.0, 2.0, 2.0, 2.0]);
}

/// Samples 1, 2 | 3 | 4, 5, 9, folded by rounds, against all at once: mean 4, variance 8.
#[test]
fn rounds_of_several_samples_weigh_by_their_number() {
    let channels = ChannelSet::new(&[Layer::Variance, Layer::Samples]);
    let mut a = Accumulator::new(GRID, channels, vec![2, 1, 3]);
    for (number, (mean, variance, n)) in [(1.5, 0.5, 2.0), (3.0, 0.0, 1.0), (6.0, 7.0, 3.0)].into_iter().enumerate() {
        round(&mut a, number as u32, &[mean, mean, mean, 1.0, variance, variance, variance, n], None);
    }
    // The third round is larger than the one before: against it the first two are one block, of mean 2. Between the blocks:
    // 3 · 2² + 3 · 2² = 24, over 1 degree of freedom and 6 samples.
    assert!((a.noise().unwrap().standard_error - 2.0).abs() < 1e-12);
    assert_eq!(a.finish().pixel(0, 0), [4.0, 4.0, 4.0, 1.0, 8.0, 8.0, 8.0, 6.0]);
}

#[test]
fn a_tile_out_of_turn_is_refused() {
    let channels = ChannelSet::new(&[]);
    let mut a = Accumulator::new(GRID, channels.clone(), vec![1; 2]);
    let t = tile(0, &channels, |_| 1.0);
    assert_eq!(a.insert(1, &t), Err(TileError::Repeated(0)));
    a.insert(0, &t).unwrap();
    assert_eq!(a.insert(0, &t), Err(TileError::Repeated(0)));
    a.insert(0, &tile(1, &channels, |_| 1.0)).unwrap();
    a.close(None);
    assert_eq!(a.insert(0, &t), Err(TileError::Repeated(0)));
    assert!(matches!(a.insert(1, &Tile { pixels: vec![], ..t.clone() }), Err(TileError::Size { .. })));
    a.insert(1, &t).unwrap();
    a.insert(1, &tile(1, &channels, |_| 1.0)).unwrap();
    a.close(None);
    assert_eq!(a.insert(2, &t), Err(TileError::Repeated(0)));
    assert_eq!(a.insert(0, &Tile { index: 9, ..t }), Err(TileError::Repeated(9)));
}

/// Rounds that came as light images: 2 and 4 splats of 3 in one pixel, of which the second counts twice; the brightness is 10,
/// known to a tenth.
#[test]
fn splatted_rounds_are_scaled_and_share_their_brightness() {
    let light = |n| {
        let mut light = LightImage::new(GRID, 2, 4.0);
        (0..n).for_each(|_| light.splat(0, 19, 4, Rgb::splat(3.0)));
        light.splat(1, 19, 4, Rgb::splat(light.unit()));
        light
    };
    let mut a = Accumulator::new(GRID, ChannelSet::new(&[]), vec![1, 2]).with_standard_error();
    a.close_splatted(&light(2), 1.0);
    assert_eq!(a.clone().finish().pixel(19, 4), [6.0, 6.0, 6.0, 1.0, f32::INFINITY, f32::INFINITY, f32::INFINITY]);
    a.close_splatted(&light(4), 0.5);
    // Two rounds of 6: nothing between them.
    assert_eq!(a.noise(), Some(Noise { standard_error: 0.0, relative: 0.0 }));
    a.set_brightness(Brightness { factor: 10.0, relative_variance: 0.01 });
    let film = a.clone().finish();
    for (got, expected) in film.pixel(19, 4).iter().zip([60.0, 60.0, 60.0, 2.0 / 3.0, 6.0, 6.0, 6.0]) {
        assert!((got - expected).abs() < 1e-5, "{got} {expected}");
    }
    assert!((a.noise().unwrap().standard_error - 6.0 / 10.0).abs() < 1e-12);
}

#[test]
fn light_images_count_by_the_samples_of_their_round() {
    let mut light = LightImage::new(GRID, 1, 1.0);
    light.splat(0, 19, 4, Rgb::splat(8.0));
    let mut a = Accumulator::new(GRID, ChannelSet::new(&[]), vec![4]);
    round(&mut a, 0, &[1.0; 4], Some(&light));
    let film = a.finish();
    assert_eq!(film.pixel(19, 4), [3.0, 3.0, 3.0, 1.0]);
    assert_eq!(film.pixel(18, 4), [1.0; 4]);
    let mut a = Accumulator::new(GRID, ChannelSet::new(&[]), vec![2, 2]);
    round(&mut a, 0, &[1.0; 4], Some(&light));
    round(&mut a, 1, &[1.0; 4], None);
    // One pixel of 100 has 5 and 1: variance 4 of its mean.
    assert!((a.noise().unwrap().standard_error - 0.2).abs() < 1e-12);
    assert_eq!(a.finish().pixel(19, 4), [3.0, 3.0, 3.0, 1.0]);
}
