//! Which method uses which options, with what defaults: the one table that command line, headers and checks read.
//!
//! Width, height, camera, seed and layers are every method's.

use super::{Estimator, Kernel, Layer, Merge, Method, RenderSettings, Strategy};
use crate::error::SettingsError;

/// An option that not every method uses.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Setting {
    /// [`RenderSettings::samples`].
    Samples,
    /// [`RenderSettings::adaptive`].
    Adaptive,
    /// [`RenderSettings::max_depth`].
    MaxDepth,
    /// [`RenderSettings::photons`].
    Photons,
    /// [`RenderSettings::caustic_photons`].
    CausticPhotons,
    /// [`RenderSettings::k`].
    K,
    /// [`RenderSettings::max_radius`].
    MaxRadius,
    /// [`RenderSettings::final_gather`].
    FinalGather,
    /// [`RenderSettings::estimator`].
    Estimator,
    /// [`RenderSettings::kernel`].
    Kernel,
    /// [`RenderSettings::direct_from_map`].
    DirectFromMap,
    /// [`RenderSettings::rounds`].
    Rounds,
    /// [`RenderSettings::radius_alpha`].
    RadiusAlpha,
    /// [`RenderSettings::merge`].
    Merge,
    /// A bound on the memory of one round's photons, which becomes [`RenderSettings::rounds`].
    Memory,
    /// [`RenderSettings::mutations`].
    Mutations,
    /// [`RenderSettings::chains`].
    Chains,
    /// [`RenderSettings::bootstrap`].
    Bootstrap,
    /// [`RenderSettings::large_step`].
    LargeStep,
}

impl Setting {
    /// All, in the order headers and help texts name them.
    pub const ALL: [Setting; 19] = [
        Setting::Samples,
        Setting::Adaptive,
        Setting::MaxDepth,
        Setting::Photons,
        Setting::CausticPhotons,
        Setting::K,
        Setting::MaxRadius,
        Setting::FinalGather,
        Setting::Estimator,
        Setting::Kernel,
        Setting::DirectFromMap,
        Setting::Rounds,
        Setting::RadiusAlpha,
        Setting::Merge,
        Setting::Memory,
        Setting::Mutations,
        Setting::Chains,
        Setting::Bootstrap,
        Setting::LargeStep,
    ];

    /// Name on the command line, without dashes.
    pub const fn name(self) -> &'static str {
        match self {
            Setting::Samples => "samples",
            Setting::Adaptive => "adaptive",
            Setting::MaxDepth => "max-depth",
            Setting::Photons => "photons",
            Setting::CausticPhotons => "caustic-photons",
            Setting::K => "k",
            Setting::MaxRadius => "max-radius",
            Setting::FinalGather => "final-gather",
            Setting::Estimator => "estimator",
            Setting::Kernel => "kernel",
            Setting::DirectFromMap => "direct-from-map",
            Setting::Rounds => "rounds",
            Setting::RadiusAlpha => "radius-alpha",
            Setting::Merge => "merge",
            Setting::Memory => "memory",
            Setting::Mutations => "mutations",
            Setting::Chains => "chains",
            Setting::Bootstrap => "bootstrap",
            Setting::LargeStep => "large-step",
        }
    }

    /// Its value in `s` as the command line writes it; empty for a switch that is on, `None` where nothing is set.
    pub fn value(self, s: &RenderSettings) -> Option<String> {
        Some(match self {
            Setting::Samples => s.samples.to_string(),
            Setting::Adaptive => s.adaptive.then(String::new)?,
            Setting::MaxDepth => s.max_depth?.to_string(),
            Setting::Photons => s.photons.to_string(),
            Setting::CausticPhotons => s.caustic_photons.to_string(),
            Setting::K => s.k.to_string(),
            Setting::MaxRadius => s.max_radius?.to_string(),
            Setting::FinalGather => s.final_gather.to_string(),
            Setting::Estimator => s.estimator.name().into(),
            Setting::Kernel => s.kernel.name().into(),
            Setting::DirectFromMap => s.direct_from_map.then(String::new)?,
            Setting::Rounds => s.rounds.to_string(),
            Setting::RadiusAlpha => s.radius_alpha.to_string(),
            Setting::Merge => s.merge.name().into(),
            Setting::Memory => return None,
            Setting::Mutations => s.mutations.to_string(),
            Setting::Chains => s.chains.to_string(),
            Setting::Bootstrap => s.bootstrap.to_string(),
            Setting::LargeStep => s.large_step.to_string(),
        })
    }

    /// The methods that use it, of those that are built.
    pub fn methods(self) -> impl Iterator<Item = Method> {
        Method::ALL.into_iter().filter(move |m| m.options().contains(&self))
    }
}

/// Photon paths of a round of `progressive` for each pixel: global, caustic; see [`RenderSettings::divide_photons`]. Emission then takes
/// some half of the gather pass's time; the optimum is flat.
const PROGRESSIVE_PATHS_PER_PIXEL: [f64; 2] = [0.5, 0.5];
/// Fewest and most of them in a round: small images need a map too, and a round of a large one is to fit into memory.
const PROGRESSIVE_PATHS_PER_ROUND: [u64; 2] = [4_096, 1 << 20];
/// Its rounds where nobody says.
const PROGRESSIVE_ROUNDS: u32 = 128;

impl Method {
    /// The options it uses beside those that are every method's.
    pub const fn options(self) -> &'static [Setting] {
        use Setting as S;
        match self {
            Method::Whitted | Method::Bdpt => &[S::Samples, S::MaxDepth],
            Method::Path => &[S::Samples, S::Adaptive, S::MaxDepth],
            Method::Mlt => &[S::MaxDepth, S::Mutations, S::Chains, S::Bootstrap, S::LargeStep],
            Method::Photon => &[
                S::Samples,
                S::Adaptive,
                S::Photons,
                S::CausticPhotons,
                S::K,
                S::MaxRadius,
                S::FinalGather,
                S::Estimator,
                S::Kernel,
                S::DirectFromMap,
            ],
            Method::Progressive => &[
                S::Photons,
                S::CausticPhotons,
                S::MaxRadius,
                S::Kernel,
                S::Rounds,
                S::RadiusAlpha,
                S::Merge,
                S::Memory,
            ],
            Method::Vcm => &[S::MaxDepth, S::Photons, S::MaxRadius, S::Rounds, S::RadiusAlpha, S::Merge],
        }
    }

    /// The layers it can write. Methods that splat know of a pixel what its camera rays meet, but not how its light divides.
    pub const fn layers(self) -> &'static [Layer] {
        use Layer as L;
        match self {
            Method::Whitted => {
                &[L::Direct, L::Albedo, L::Normal, L::Depth, L::Position, L::Variance, L::Samples, L::StandardError]
            }
            Method::Path | Method::Photon | Method::Progressive => &[
                L::Direct,
                L::Indirect,
                L::Caustic,
                L::Albedo,
                L::Normal,
                L::Depth,
                L::Position,
                L::Variance,
                L::Samples,
                L::StandardError,
            ],
            Method::Mlt => &[L::StandardError],
            Method::Bdpt => &[L::Albedo, L::Normal, L::Depth, L::Position, L::Samples, L::StandardError, L::Strategies],
            Method::Vcm => &[L::Albedo, L::Normal, L::Depth, L::Position, L::Samples, L::StandardError],
        }
    }

    /// Whether light paths are shown to the camera, and land anywhere.
    pub const fn splats(self) -> bool {
        matches!(self, Method::Bdpt | Method::Vcm)
    }

    /// Whether its mean over ever more samples, photons and rounds is all the light there is.
    pub const fn is_consistent(self) -> bool {
        !matches!(self, Method::Whitted)
    }

    /// What it is for, in a few words, for help texts.
    pub const fn purpose(self) -> &'static str {
        match self {
            Method::Whitted => "direct light, mirrors and glass only: a quick look",
            Method::Path => "no bias; slow on caustics",
            Method::Bdpt => "no bias; light that is hard to reach from the camera alone",
            Method::Mlt => "no bias; light through narrow openings",
            Method::Photon => "sharp caustics, smooth indirect light",
            Method::Progressive => "photon mapping whose bias and noise both vanish, in bounded memory",
            Method::Vcm => "caustics seen in mirrors and through glass",
        }
    }

    /// Refuses an option in `given` that this method does not use.
    ///
    /// # Errors
    /// Names the first such option, and those that the method uses.
    pub fn refuse_unused(self, given: &[Setting]) -> Result<(), SettingsError> {
        let Some(unused) = given.iter().find(|s| !self.options().contains(s)) else { return Ok(()) };
        let own: Vec<String> = self.options().iter().map(|s| format!("--{}", s.name())).collect();
        let message = format!("not used by method {}, which takes {}", self.name(), enumerate(&own));
        Err(SettingsError { setting: unused.name(), message })
    }

    /// Refuses a layer in `layers` that this method cannot write.
    ///
    /// # Errors
    /// Names the first such layer, and those that the method has.
    pub fn refuse_layers(self, layers: &[Layer]) -> Result<(), SettingsError> {
        let Some(layer) = layers.iter().find(|l| !self.layers().contains(l)) else { return Ok(()) };
        let own: Vec<String> = self.layers().iter().map(|l| l.name().into()).collect();
        let message = format!("method {} has no {}; it has {}", self.name(), layer.name(), enumerate(&own));
        Err(SettingsError { setting: "layers", message })
    }
}

impl RenderSettings {
    /// The defaults of `method`, with its usual number of rounds.
    pub fn for_method(method: Method) -> Self {
        let base = RenderSettings { method, ..RenderSettings::default() };
        let settings = match method {
            Method::Whitted => RenderSettings { samples: 4, ..base },
            Method::Path => RenderSettings { samples: 64, ..base },
            Method::Progressive => RenderSettings { rounds: PROGRESSIVE_ROUNDS, kernel: Kernel::Epanechnikov, ..base },
            Method::Bdpt | Method::Mlt | Method::Photon | Method::Vcm => base,
        };
        let [photons, caustic_photons] = settings.default_photons();
        RenderSettings { photons, caustic_photons, ..settings }
    }

    /// Planes of the light image: plane 0 is the image. 0 where nothing lands elsewhere than in its own tile.
    pub fn light_planes(&self) -> u32 {
        if self.has_independent_rounds() {
            // Whole rounds; the second is their alpha.
            2
        } else if self.layers.contains(&Layer::Strategies) {
            1 + Strategy::PLANES
        } else {
            u32::from(self.method.splats() || self.method == Method::Mlt)
        }
    }

    /// Photon paths of the global and the caustic map where nobody says: of methods with rounds as many as their number
    /// and that of the pixels make. A round of `vcm` traces a light path for each pixel (Georgiev et al. 2012, §5).
    pub fn default_photons(&self) -> [u64; 2] {
        let (rounds, pixels) = (u64::from(self.rounds), u64::from(self.width) * u64::from(self.height));
        match self.method {
            Method::Progressive => PROGRESSIVE_PATHS_PER_PIXEL.map(|share| {
                let [least, most] = PROGRESSIVE_PATHS_PER_ROUND;
                ((pixels as f64 * share) as u64).clamp(least, most) * rounds
            }),
            Method::Vcm => [pixels * rounds, 0],
            _ => [500_000, 1_000_000],
        }
    }
}

/// `a`, `a and b`, `a, b and c`.
pub(crate) fn enumerate(words: &[String]) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [first @ .., last] => format!("{} and {last}", first.join(", ")),
    }
}

impl Estimator {
    /// Both, in the order help texts name them.
    pub const ALL: [Estimator; 2] = [Estimator::KdTree, Estimator::Hash];
    /// Name on the command line and in headers.
    pub const fn name(self) -> &'static str {
        match self {
            Estimator::KdTree => "kdtree",
            Estimator::Hash => "hash",
        }
    }
}

impl Kernel {
    /// All, in the order help texts name them.
    pub const ALL: [Kernel; 3] = [Kernel::Constant, Kernel::Cone, Kernel::Epanechnikov];
    /// Name on the command line and in headers.
    pub const fn name(self) -> &'static str {
        match self {
            Kernel::Constant => "constant",
            Kernel::Cone => "cone",
            Kernel::Epanechnikov => "epanechnikov",
        }
    }
}

impl Merge {
    /// Both, in the order help texts name them.
    pub const ALL: [Merge; 2] = [Merge::Shared, Merge::Independent];
    /// Name on the command line and in headers.
    pub const fn name(self) -> &'static str {
        match self {
            Merge::Shared => "shared",
            Merge::Independent => "independent",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const METHODS: [Method; 7] =
        [Method::Whitted, Method::Path, Method::Bdpt, Method::Mlt, Method::Photon, Method::Progressive, Method::Vcm];

    #[test]
    fn every_option_is_some_method_s_and_named_once() {
        for setting in Setting::ALL {
            assert!(METHODS.iter().any(|m| m.options().contains(&setting)), "{}", setting.name());
        }
        let mut names = Setting::ALL.map(Setting::name);
        names.sort_unstable();
        assert!(names.windows(2).all(|w| w[0] != w[1]));
        for method in METHODS {
            // In the order of the enumerations, so that texts read alike; sorted lists have no duplicates.
            assert!(method.options().is_sorted_by(|a, b| a < b), "{}", method.name());
            assert!(method.layers().is_sorted_by(|a, b| a < b), "{}", method.name());
        }
    }

    #[test]
    fn an_unused_option_is_refused_with_the_method_s_own_list() {
        let refused = |m: Method, s| m.refuse_unused(&[Setting::MaxDepth, s]).map_err(|e| e.to_string());
        assert_eq!(
            refused(Method::Path, Setting::K),
            Err("--k: not used by method path, which takes --samples, --adaptive and --max-depth".into())
        );
        assert_eq!(refused(Method::Path, Setting::Samples), Ok(()));
        let error = Method::Mlt.refuse_unused(&[Setting::Samples]).unwrap_err().to_string();
        assert!(error.starts_with("--samples: ") && error.contains("--mutations, --chains"), "{error}");
    }

    #[test]
    fn a_layer_that_a_method_lacks_is_refused() {
        let error = Method::Bdpt.refuse_layers(&[Layer::Caustic, Layer::Depth]).unwrap_err().to_string();
        assert_eq!(
            error,
            "--layers: method bdpt has no caustic; it has albedo, normal, depth, position, samples, standard-error and strategies"
        );
        assert!(Method::Path.refuse_layers(&Layer::ALL).is_err());
        assert!(Method::Path.refuse_layers(Method::Photon.layers()).is_ok());
    }

    #[test]
    fn every_method_s_defaults_are_valid() {
        for method in Method::ALL {
            let s = RenderSettings::for_method(method);
            assert_eq!((s.method, s.validate()), (method, Ok(())));
        }
        assert_eq!(RenderSettings::for_method(Method::Photon), RenderSettings::default());
    }
}
