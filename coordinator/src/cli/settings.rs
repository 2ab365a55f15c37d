//! The options that determine an image, as flags.

use super::error::CliError;
use clap::Args;
use clap::builder::{PossibleValuesParser, TypedValueParser};
use gatherlight_render::export::metadata::{estimator_name, kernel_name};
use gatherlight_render::scene::description::{CameraDescription, Projection};
use gatherlight_render::settings::{CameraChoice, Estimator, Kernel, Layer, Method, RenderSettings};

/// Pixels down when neither `--width` nor `--height` is given.
const DEFAULT_HEIGHT: u32 = 512;

/// Options that determine the image.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Image")]
pub(super) struct SettingsArgs {
    /// How light transport is computed: photon mapping (sharp caustics) or path tracing (slow on caustics, no bias)
    #[arg(long, value_parser = choice(&Method::ALL, Method::name), default_value = "photon")]
    method: Method,
    /// Pixels across [default: from the height and the camera's aspect ratio]
    #[arg(long, value_name = "PIXELS")]
    width: Option<u32>,
    /// Pixels down [default: 512, or from the width and the camera's aspect ratio]
    #[arg(long, value_name = "PIXELS")]
    height: Option<u32>,
    /// Camera by name, or by index in file order; digits alone are an index [default: the first]
    #[arg(long, value_name = "NAME|INDEX")]
    camera: Option<String>,
    /// Camera samples per pixel
    #[arg(long, value_name = "N", value_parser = count32, default_value_t = RenderSettings::default().samples)]
    samples: u32,
    /// Seed of every random number: the same seed gives the same image, bit for bit
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// Longest path in edges between camera and light [default: unlimited]
    #[arg(long, value_name = "N")]
    max_depth: Option<u32>,
    /// Layers beside the colour, separated by commas
    #[arg(long, value_parser = choice(&Layer::ALL, Layer::name), value_name = "LAYER,…", value_delimiter = ',')]
    layers: Vec<Layer>,
    #[command(flatten)]
    photon: PhotonArgs,
}

/// Options of photon mapping.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Photon mapping")]
struct PhotonArgs {
    /// Photon paths emitted for the global map, e.g. 500k or 10M
    #[arg(long, value_name = "N", value_parser = count64, default_value = "500k")]
    photons: u64,
    /// Photon paths emitted for the caustic map
    #[arg(long, value_name = "N", value_parser = count64, default_value = "1M")]
    caustic_photons: u64,
    /// Photons in one density estimate
    #[arg(long, value_name = "K", value_parser = count32, default_value_t = RenderSettings::default().k)]
    k: u32,
    /// Largest gather radius in the scene's units [default: from the map's density]
    #[arg(long, value_name = "RADIUS")]
    max_radius: Option<f32>,
    /// Final-gather rays per camera sample; 0 looks at the global map directly
    #[arg(long, value_name = "N", value_parser = count32, default_value_t = RenderSettings::default().final_gather)]
    final_gather: u32,
    /// Search structure: k nearest in a k-d tree, or a fixed radius in a spatial hash
    #[arg(long, value_parser = choice(&ESTIMATORS, estimator_name), default_value = "kdtree")]
    estimator: Estimator,
    /// Weight of a photon by its distance
    #[arg(long, value_parser = choice(&KERNELS, kernel_name), default_value = "constant")]
    kernel: Kernel,
}

const ESTIMATORS: [Estimator; 2] = [Estimator::KdTree, Estimator::Hash];
const KERNELS: [Kernel; 3] = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov];

/// Reads one of `all` by its name; help and errors list them.
fn choice<T: Copy + Send + Sync + 'static>(
    all: &'static [T],
    name: fn(T) -> &'static str,
) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(all.iter().map(|&t| name(t))).try_map(move |text| {
        all.iter().copied().find(|&t| name(t) == text).ok_or_else(|| format!("{text:?} is not one of the choices"))
    })
}

impl SettingsArgs {
    /// The camera asked for.
    pub(super) fn camera(&self) -> CameraChoice {
        match &self.camera {
            None => CameraChoice::First,
            Some(c) => c.parse().map_or_else(|_| CameraChoice::Name(c.clone()), CameraChoice::Index),
        }
    }

    /// Whether the image's size depends on the camera's aspect ratio.
    pub(super) fn needs_aspect(&self) -> bool {
        self.width.is_none() || self.height.is_none()
    }

    /// Checks what can be checked without the scene.
    ///
    /// # Errors
    /// Names the first option that makes no sense and what is valid.
    pub(super) fn check(&self) -> Result<(), CliError> {
        // A side that follows from the camera may be anything yet.
        self.sized(self.width.unwrap_or(1), self.height.unwrap_or(1)).map(drop)
    }

    /// The settings, checked; `aspect` is the camera's width / height.
    ///
    /// # Errors
    /// Names the first option that makes no sense and what is valid.
    pub(super) fn settings(&self, aspect: f64) -> Result<RenderSettings, CliError> {
        let across = |height: u32| (f64::from(height) * aspect).round().max(1.0) as u32;
        let down = |width: u32| (f64::from(width) / aspect).round().max(1.0) as u32;
        let (width, height) = match (self.width, self.height) {
            (Some(w), Some(h)) => (w, h),
            (Some(w), None) => (w, down(w)),
            (None, Some(h)) => (across(h), h),
            (None, None) => (across(DEFAULT_HEIGHT), DEFAULT_HEIGHT),
        };
        self.sized(width, height)
    }

    fn sized(&self, width: u32, height: u32) -> Result<RenderSettings, CliError> {
        let mut layers = self.layers.clone();
        layers.sort_unstable();
        let p = &self.photon;
        let settings = RenderSettings {
            method: self.method,
            width,
            height,
            camera: self.camera(),
            samples: self.samples,
            seed: self.seed,
            max_depth: self.max_depth,
            photons: p.photons,
            caustic_photons: p.caustic_photons,
            k: p.k,
            max_radius: p.max_radius,
            final_gather: p.final_gather,
            estimator: p.estimator,
            kernel: p.kernel,
            layers,
            ..RenderSettings::default()
        };
        settings.validate()?;
        Ok(settings)
    }
}

/// Width / height of the camera that `choice` means; 1 where the file does not say or there is no such camera (which
/// the renderer itself reports).
pub(super) fn camera_aspect(cameras: &[CameraDescription], choice: &CameraChoice) -> f64 {
    let camera = match choice {
        CameraChoice::First => cameras.first(),
        CameraChoice::Index(i) => cameras.get(*i as usize),
        CameraChoice::Name(n) => cameras.iter().find(|c| c.name == *n),
    };
    let aspect = camera.and_then(|c| match c.projection {
        Projection::Perspective { aspect, .. } => aspect,
        Projection::Orthographic { xmag, ymag } => Some((xmag / ymag).abs()),
    });
    aspect.filter(|a| a.is_finite() && (1e-3..=1e3).contains(a)).unwrap_or(1.0)
}

/// `10M`, `2.5k`, `1_000_000`, `1e6` → a whole number.
pub(super) fn count64(text: &str) -> Result<u64, String> {
    let digits: String = text.chars().filter(|&c| c != '_').collect();
    let (number, factor) = match digits.chars().last() {
        Some('k' | 'K') => (&digits[..digits.len() - 1], 1e3),
        Some('M') => (&digits[..digits.len() - 1], 1e6),
        Some('G') => (&digits[..digits.len() - 1], 1e9),
        _ => (digits.as_str(), 1.0),
    };
    if factor == 1.0
        && let Ok(whole) = number.parse()
    {
        return Ok(whole);
    }
    let explain = || format!("{text:?} is no count; write a whole number such as 500000, 500k, 10M or 1G");
    let value = number.parse::<f64>().map_err(|_| explain())? * factor;
    // Up to 2⁵³ doubles hold every whole number.
    let whole = (0.0..=9_007_199_254_740_992.0).contains(&value) && (value - value.round()).abs() <= value * 1e-12;
    if whole { Ok(value.round() as u64) } else { Err(explain()) }
}

/// As [`count64`], up to 2³² − 1.
pub(super) fn count32(text: &str) -> Result<u32, String> {
    let value = count64(text)?;
    u32::try_from(value).map_err(|_| format!("{value} is more than {}", u32::MAX))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_take_suffixes() {
        let good = ["0", "7", "500k", "10M", "2.5k", "1_000", "1e6", "1G", "18446744073709551615", "0.3k"];
        let values = good.map(|t| count64(t).unwrap());
        assert_eq!(values, [0, 7, 500_000, 10_000_000, 2500, 1000, 1_000_000, 1_000_000_000, u64::MAX, 300]);
        for bad in ["", "k", "-1", "1.5", "ten", "1e300", "nan", "inf", "0.0001k", "1m"] {
            assert!(count64(bad).is_err(), "{bad}");
        }
        assert!(count32("5G").unwrap_err().contains("more than"));
    }

    #[test]
    fn the_flags_defaults_are_the_library_s() {
        #[derive(clap::Parser)]
        struct Flags {
            #[command(flatten)]
            settings: SettingsArgs,
        }
        let flags = <Flags as clap::Parser>::parse_from(["gatherlight"]);
        assert_eq!(flags.settings.settings(1.0).unwrap(), RenderSettings::default());
    }
}
