//! The options that determine an image, as flags.

use super::error::CliError;
use super::format::bytes;
use super::options::OptionArgs;
use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use gatherlight_render::auto::{self, Choice};
use gatherlight_render::plan::Plan;
use gatherlight_render::scene::description::{CameraDescription, Projection, SceneDescription};
use gatherlight_render::settings::{CameraChoice, Layer, MAX_ROUNDS, Method, RenderSettings};

/// Pixels down when neither `--width` nor `--height` is given.
const DEFAULT_HEIGHT: u32 = 512;
/// Leaves the choice of the method to the scene.
const AUTO: &str = "auto";

/// Options that determine the image.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Image")]
pub(super) struct SettingsArgs {
    /// How light transport is computed; auto: chosen by what the scene holds, see `gatherlight plan`
    #[arg(long, value_parser = method_or_auto(), default_value = AUTO)]
    method: MethodChoice,
    /// Pixels across [default: from the height and the camera's aspect ratio]
    #[arg(long, value_name = "PIXELS")]
    width: Option<u32>,
    /// Pixels down [default: 512, or from the width and the camera's aspect ratio]
    #[arg(long, value_name = "PIXELS")]
    height: Option<u32>,
    /// Camera by name, or by index in file order; digits alone are an index [default: the first]
    #[arg(long, value_name = "NAME|INDEX")]
    camera: Option<String>,
    /// Seed of every random number: the same seed gives the same image, bit for bit
    #[arg(long, value_name = "S", default_value_t = 0)]
    seed: u64,
    /// Layers beside the colour, separated by commas
    #[arg(long, value_parser = choice(&Layer::ALL, Layer::name), value_name = "LAYER,…", value_delimiter = ',')]
    layers: Vec<Layer>,
    /// Compute, decode and send also what the plan leaves out, to compare: the same pixels, for more time and memory
    #[arg(long)]
    keep_all: bool,
    #[command(flatten)]
    options: OptionArgs,
}

/// What `--method` says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct MethodChoice(Option<Method>);

fn method_or_auto() -> impl TypedValueParser<Value = MethodChoice> {
    let auto = PossibleValue::new(AUTO).help("what the scene asks for");
    let named = Method::ALL.into_iter().map(|m| PossibleValue::new(m.name()).help(m.purpose()));
    PossibleValuesParser::new(std::iter::once(auto).chain(named))
        .map(|text| MethodChoice(Method::ALL.into_iter().find(|m| m.name() == text)))
}

/// Reads one of `all` by its name; help and errors list them.
pub(super) fn choice<T: Copy + Send + Sync + 'static>(
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

    /// Whether nothing is to be left out.
    pub(super) fn keep_all(&self) -> bool {
        self.keep_all
    }

    /// Whether the scene has a say in the settings.
    pub(super) fn needs_scene(&self) -> bool {
        self.width.is_none() || self.height.is_none() || self.method.0.is_none()
    }

    /// Checks what can be checked without the scene.
    ///
    /// # Errors
    /// Names the first option that makes no sense and what is valid.
    pub(super) fn check(&self) -> Result<(), CliError> {
        let method = match self.method.0 {
            Some(method) => method,
            None => {
                let candidates = auto::candidates(&self.options.given(), &self.sorted_layers())?;
                // They share the options that are given, and with them what is valid.
                candidates.first().copied().unwrap_or(Method::Path)
            }
        };
        // A side that follows from the camera may be anything yet.
        self.sized(method, self.width.unwrap_or(1), self.height.unwrap_or(1)).map(drop)
    }

    /// Whether a method is named.
    pub(super) fn names_method(&self) -> bool {
        self.method.0.is_some()
    }

    /// The method named, or the one that `scene` asks for.
    ///
    /// # Errors
    /// When no method uses all the options that are given.
    pub(super) fn method(&self, scene: &SceneDescription) -> Result<Choice, CliError> {
        match self.method.0 {
            Some(method) => Ok(Choice { method, reason: "asked for".into() }),
            None => Ok(auto::choose(scene, &self.options.given(), &self.sorted_layers())?),
        }
    }

    /// The settings for `method`, checked; `aspect` is the camera's width / height.
    ///
    /// # Errors
    /// Names the first option that makes no sense and what is valid.
    pub(super) fn settings(&self, method: Method, aspect: f64) -> Result<RenderSettings, CliError> {
        let across = |height: u32| (f64::from(height) * aspect).round().max(1.0) as u32;
        let down = |width: u32| (f64::from(width) / aspect).round().max(1.0) as u32;
        let (width, height) = match (self.width, self.height) {
            (Some(w), Some(h)) => (w, h),
            (Some(w), None) => (w, down(w)),
            (None, Some(h)) => (across(h), h),
            (None, None) => (across(DEFAULT_HEIGHT), DEFAULT_HEIGHT),
        };
        self.sized(method, width, height)
    }

    fn sized(&self, method: Method, width: u32, height: u32) -> Result<RenderSettings, CliError> {
        method.refuse_unused(&self.options.given())?;
        let mut settings = RenderSettings {
            width,
            height,
            camera: self.camera(),
            seed: self.seed,
            layers: self.sorted_layers(),
            keep_all: self.keep_all,
            ..RenderSettings::for_method(method)
        };
        self.options.apply(&mut settings);
        settings.validate()?;
        Ok(settings)
    }

    fn sorted_layers(&self) -> Vec<Layer> {
        let mut layers = self.layers.clone();
        layers.sort_unstable();
        layers
    }

    /// `settings` without an end of their own, unless it is given how much is computed.
    ///
    /// # Errors
    /// When that makes no sense.
    pub(super) fn open_ended(&self, settings: RenderSettings) -> Result<RenderSettings, CliError> {
        if self.options.has_count(settings.method) {
            return Ok(settings);
        }
        let settings = settings.open_ended();
        settings.validate()?;
        Ok(settings)
    }

    /// The bound on the memory of one round's photons, in bytes, if there is one.
    pub(super) fn memory(&self) -> Option<u64> {
        self.options.memory()
    }

    /// Raises the number of rounds until the photons of one take at most `memory` bytes, as far as `plan` expects.
    ///
    /// # Errors
    /// When the number of rounds is given and too small, or no number is large enough.
    pub(super) fn fit_memory(&self, settings: &mut RenderSettings, plan: &Plan, memory: u64) -> Result<(), CliError> {
        let needed = plan.rounds_within(memory);
        let most = [settings.photons, settings.caustic_photons].into_iter().filter(|&n| n > 0).min();
        if needed > most.unwrap_or(u64::MAX).min(MAX_ROUNDS.into()) {
            let limit = bytes(memory);
            return Err(CliError::Usage(format!(
                "--memory: {limit} would need {needed} rounds; give more, or emit fewer --photons"
            )));
        }
        let needed = u32::try_from(needed).unwrap_or(MAX_ROUNDS);
        if self.options.has_rounds() && needed > settings.rounds {
            let (limit, rounds) = (bytes(memory), settings.rounds);
            let message =
                format!("--memory: {limit} needs {needed} rounds, but --rounds is {rounds}; leave one of them out");
            return Err(CliError::Usage(message));
        }
        settings.rounds = settings.rounds.max(needed);
        Ok(settings.validate()?)
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

    #[derive(clap::Parser)]
    struct Flags {
        #[command(flatten)]
        settings: SettingsArgs,
    }

    fn flags(args: &str) -> SettingsArgs {
        <Flags as clap::Parser>::parse_from(std::iter::once("gatherlight").chain(args.split_whitespace())).settings
    }

    #[test]
    fn the_flags_defaults_are_the_library_s() {
        for method in Method::ALL {
            let name = method.name();
            let settings = flags(&format!("--method {name}")).settings(method, 1.0).unwrap();
            // Who gives no number of photons wants them where the light is.
            let divide_photons = method == Method::Progressive;
            assert_eq!(settings, RenderSettings { divide_photons, ..RenderSettings::for_method(method) }, "{name}");
        }
    }

    #[test]
    fn the_plain_estimate_needs_no_final_gather() {
        let settings = flags("--direct-from-map --photons 10k --k 50").settings(Method::Photon, 1.0).unwrap();
        assert!(settings.direct_from_map && settings.final_gather == 0 && settings.k == 50);
        let error = flags("--direct-from-map --final-gather 4").settings(Method::Photon, 1.0).unwrap_err();
        assert!(error.to_string().contains("--final-gather: 4 with --direct-from-map"), "{error}");
    }
}
