//! What determines an image: everything here, together with the scene's digest, and nothing else.

mod blocks;
mod open_ended;
mod options;
mod splats;
pub mod strategies;

pub use blocks::Pass;
pub use open_ended::ENDLESS;
pub use options::Setting;
pub(crate) use options::enumerate;
pub use strategies::Strategy;

use crate::error::SettingsError;
use serde::{Deserialize, Serialize};

/// Largest number of pixels along one side.
pub const MAX_IMAGE_SIDE: u32 = 65_536;
/// Largest number of pixels of an image.
pub const MAX_IMAGE_PIXELS: u64 = 1 << 30;
/// Largest number of emitted photon paths of one map.
pub const MAX_PHOTONS: u64 = 1 << 40;
/// Largest number of samples per pixel.
pub const MAX_SAMPLES: u32 = 1 << 24;
/// Largest number of neighbours in one density estimate.
pub const MAX_K: u32 = 100_000;
/// Largest number of rounds.
pub const MAX_ROUNDS: u32 = 65_536;
/// Largest number of Markov chains.
pub const MAX_CHAINS: u32 = 1 << 24;
/// Largest number of mutations per pixel.
pub const MAX_MUTATIONS: u32 = 1 << 24;
/// Largest number of bootstrap paths.
pub const MAX_BOOTSTRAP: u64 = 1 << 26;
/// Largest number of final-gather rays per camera sample.
pub const MAX_FINAL_GATHER: u32 = 65_536;
/// Fewest samples per pixel that adaptive sampling has anything to decide about.
pub const MIN_ADAPTIVE_SAMPLES: u32 = 16;
/// Side of a square tile in pixels; edge tiles are cropped.
pub const TILE_SIZE: u32 = 16;

/// The way light transport is computed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Method {
    /// Direct light, mirrors and glass (Whitted 1980): a preview.
    Whitted,
    /// Path tracing with next-event estimation and MIS (Kajiya 1986; Veach 1997).
    Path,
    /// Bidirectional path tracing (Lafortune and Willems 1993; Veach and Guibas 1994).
    Bdpt,
    /// Metropolis light transport (Veach and Guibas 1997; Kelemen et al. 2002; Hachisuka et al. 2014).
    Mlt,
    /// Photon mapping: emission, merge, gather (Jensen 1996, 2001).
    Photon,
    /// Progressive photon mapping (Hachisuka et al. 2008; Knaus and Zwicker 2011).
    Progressive,
    /// Vertex connection and merging (Georgiev et al. 2012; Hachisuka et al. 2012).
    Vcm,
}

impl Method {
    /// All methods, in the order help texts name them.
    pub const ALL: [Method; 7] =
        [Method::Whitted, Method::Path, Method::Bdpt, Method::Mlt, Method::Photon, Method::Progressive, Method::Vcm];
    /// Name on the command line and in headers.
    pub const fn name(self) -> &'static str {
        match self {
            Method::Whitted => "whitted",
            Method::Path => "path",
            Method::Bdpt => "bdpt",
            Method::Mlt => "mlt",
            Method::Photon => "photon",
            Method::Progressive => "progressive",
            Method::Vcm => "vcm",
        }
    }
    /// Whether the image is the mean over rounds of one camera sample a pixel each, rather than over samples.
    pub const fn has_rounds(self) -> bool {
        matches!(self, Method::Progressive | Method::Vcm)
    }
}

/// Where the photons or light vertices of a round come together.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Merge {
    /// One map of all workers' photons a round.
    #[default]
    Shared,
    /// Each round is computed whole by one worker, and only images travel (Knaus and Zwicker 2011, §6).
    Independent,
}

/// Search structure over the photons.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Estimator {
    /// k nearest neighbours in a k-d tree.
    #[default]
    KdTree,
    /// Fixed radius in a spatial hash grid.
    Hash,
}

/// Weight of a photon by its distance on the tangent disc.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Default)]
pub enum Kernel {
    /// Equal weights.
    #[default]
    Constant,
    /// Linear fall to 0 at the rim.
    Cone,
    /// 1 − r²/R².
    Epanechnikov,
}

/// Extra image layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Layer {
    /// Radiance of direct light (emission seen included).
    Direct,
    /// Radiance of indirect diffuse light.
    Indirect,
    /// Radiance of caustics.
    Caustic,
    /// Base reflectance of the first hit.
    Albedo,
    /// Shading normal of the first hit, world space.
    Normal,
    /// Distance from the camera along its axis, in world units.
    Depth,
    /// World position of the first hit.
    Position,
    /// Variance of the samples of each channel.
    Variance,
    /// Samples taken.
    Samples,
    /// Standard error of each channel, by what the rounds of the image differ: see
    /// [`Accumulator::noise`](crate::film::Accumulator::noise). Infinite for a single round.
    StandardError,
    /// Radiance by each strategy of short paths, weighted and unweighted: see [`Strategy`].
    Strategies,
}

impl Layer {
    /// All layers in file order.
    pub const ALL: [Layer; 11] = [
        Layer::Direct,
        Layer::Indirect,
        Layer::Caustic,
        Layer::Albedo,
        Layer::Normal,
        Layer::Depth,
        Layer::Position,
        Layer::Variance,
        Layer::Samples,
        Layer::StandardError,
        Layer::Strategies,
    ];
    /// Name on the command line and in EXR channel names.
    pub const fn name(self) -> &'static str {
        match self {
            Layer::Direct => "direct",
            Layer::Indirect => "indirect",
            Layer::Caustic => "caustic",
            Layer::Albedo => "albedo",
            Layer::Normal => "normal",
            Layer::Depth => "depth",
            Layer::Position => "position",
            Layer::Variance => "variance",
            Layer::Samples => "samples",
            Layer::StandardError => "standard-error",
            Layer::Strategies => "strategies",
        }
    }
    /// Number of its channels.
    pub const fn width(self) -> usize {
        match self {
            Layer::Direct | Layer::Indirect | Layer::Caustic | Layer::Albedo | Layer::Variance => 3,
            Layer::Normal | Layer::Position | Layer::StandardError => 3,
            Layer::Depth | Layer::Samples => 1,
            Layer::Strategies => 3 * Strategy::PLANES as usize,
        }
    }
    /// EXR channel suffixes: `R G B`, `X Y Z`, or `V` for one value (the EXR is `layer.suffix`).
    pub fn channel_names(self) -> Vec<String> {
        let names: &[&str] = match self {
            Layer::Direct | Layer::Indirect | Layer::Caustic | Layer::Albedo | Layer::Variance => &["R", "G", "B"],
            Layer::StandardError => &["R", "G", "B"],
            Layer::Normal | Layer::Position => &["X", "Y", "Z"],
            Layer::Depth => &["Z"],
            Layer::Samples => &["V"],
            Layer::Strategies => return Strategy::channel_names(),
        };
        names.iter().map(|&n| n.into()).collect()
    }
    /// Whether it is made of whole images, so that tiles have nothing of it.
    pub const fn is_of_image(self) -> bool {
        matches!(self, Layer::StandardError | Layer::Strategies)
    }
}

/// Camera choice.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Default)]
pub enum CameraChoice {
    /// The first camera, or a default one that frames the scene.
    #[default]
    First,
    /// By index in file order.
    Index(u32),
    /// By name.
    Name(String),
}

/// Everything that determines the image besides the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct RenderSettings {
    /// Method.
    pub method: Method,
    /// Pixels across.
    pub width: u32,
    /// Pixels down.
    pub height: u32,
    /// Camera.
    pub camera: CameraChoice,
    /// Camera samples per pixel, ≥ 1.
    pub samples: u32,
    /// Whether later samples go where the first ones have shown more error; the number of samples is then a mean.
    pub adaptive: bool,
    /// Seed.
    pub seed: u64,
    /// Longest path in edges between camera and light; `None`: unlimited (roulette ends paths).
    pub max_depth: Option<u32>,
    /// Emitted paths of the global map.
    pub photons: u64,
    /// Emitted paths of the caustic map.
    pub caustic_photons: u64,
    /// Where there are both maps, the plan divides their paths anew between them, by the light that each holds.
    pub divide_photons: bool,
    /// Neighbours of a density estimate.
    pub k: u32,
    /// Largest gather radius in world units; `None`: from the map's density.
    pub max_radius: Option<f32>,
    /// Final-gather rays per camera sample; 0: the global map is looked at directly.
    pub final_gather: u32,
    /// Search structure.
    pub estimator: Estimator,
    /// Kernel of the density estimate.
    pub kernel: Kernel,
    /// Look at all light in the photon maps, direct light too, instead of estimating it: the seeds' plain estimate.
    pub direct_from_map: bool,
    /// Rounds of `progressive` and `vcm`, ≥ 1; `photons` and `caustic_photons` are their total over all rounds.
    pub rounds: u32,
    /// Exponent α of the radius, rᵢ₊₁² = rᵢ² (i + α)/(i + 1), in (0, 1) (Knaus and Zwicker 2011, eq. 20).
    pub radius_alpha: f32,
    /// Where the photons of a round come together.
    pub merge: Merge,
    /// Markov chains of `mlt`, ≥ 1.
    pub chains: u32,
    /// Mean number of mutations per pixel of `mlt`, ≥ 1.
    pub mutations: u32,
    /// Bootstrap paths of `mlt` per path length, ≥ 1.
    pub bootstrap: u64,
    /// Probability of a large step of `mlt`, in (0, 1].
    pub large_step: f32,
    /// Extra layers, sorted, without duplicates.
    pub layers: Vec<Layer>,
    /// Compute, decode and send also what the plan would leave out, for comparison. The one setting that changes no bit
    /// of the image; it is here all the same, because all processes of a job must make the same plan.
    pub keep_all: bool,
}

impl Default for RenderSettings {
    fn default() -> Self {
        RenderSettings {
            method: Method::Photon,
            width: 512,
            height: 512,
            camera: CameraChoice::First,
            samples: 32,
            adaptive: false,
            seed: 0,
            max_depth: None,
            photons: 500_000,
            caustic_photons: 1_000_000,
            divide_photons: false,
            k: 60,
            max_radius: None,
            final_gather: 4,
            estimator: Estimator::KdTree,
            kernel: Kernel::Constant,
            direct_from_map: false,
            rounds: 64,
            radius_alpha: 2.0 / 3.0,
            merge: Merge::Shared,
            chains: 1024,
            mutations: 64,
            bootstrap: 65_536,
            large_step: 0.3,
            layers: Vec::new(),
            keep_all: false,
        }
    }
}

impl RenderSettings {
    /// Checks every setting against its valid range.
    ///
    /// # Errors
    /// Names the first setting that makes no sense, and what is valid.
    pub fn validate(&self) -> Result<(), SettingsError> {
        let bad = |setting, message: String| Err(SettingsError { setting, message });
        if !Method::ALL.contains(&self.method) {
            return bad("method", format!("{} is not built yet", self.method.name()));
        }
        for (setting, v) in [("width", self.width), ("height", self.height)] {
            if v == 0 || v > MAX_IMAGE_SIDE {
                return bad(setting, format!("{v} is outside 1 … {MAX_IMAGE_SIDE} pixels"));
            }
        }
        if u64::from(self.width) * u64::from(self.height) > MAX_IMAGE_PIXELS {
            return bad("width", format!("{} × {} exceeds {MAX_IMAGE_PIXELS} pixels", self.width, self.height));
        }
        if self.samples == 0 || self.samples > MAX_SAMPLES {
            return bad("samples", format!("{} is outside 1 … {MAX_SAMPLES}", self.samples));
        }
        if self.photons > MAX_PHOTONS {
            return bad("photons", format!("{} is more than {MAX_PHOTONS}", self.photons));
        }
        if self.caustic_photons > MAX_PHOTONS {
            return bad("caustic-photons", format!("{} is more than {MAX_PHOTONS}", self.caustic_photons));
        }
        if self.k < 2 || self.k > MAX_K {
            return bad("k", format!("{} is outside 2 … {MAX_K}", self.k));
        }
        if self.final_gather > MAX_FINAL_GATHER {
            return bad("final-gather", format!("{} is more than {MAX_FINAL_GATHER}", self.final_gather));
        }
        if self.max_radius.is_some_and(|r| !(r.is_finite() && r > 0.0)) {
            return bad("max-radius", "must be a finite length above 0, in the scene's units".into());
        }
        if self.rounds == 0 || self.rounds > MAX_ROUNDS {
            return bad("rounds", format!("{} is outside 1 … {MAX_ROUNDS}", self.rounds));
        }
        if !(self.radius_alpha > 0.0 && self.radius_alpha < 1.0) {
            return bad("radius-alpha", format!("{} is not between 0 and 1", self.radius_alpha));
        }
        self.validate_chains()?;
        self.validate_light_image()?;
        self.validate_for_method()?;
        if self.max_depth == Some(0) {
            return bad("max-depth", "must be at least 1 (1 shows only emission seen directly)".into());
        }
        if self.has_independent_rounds() && self.layers.iter().any(|l| !l.is_of_image()) {
            let text = "independent rounds give the colour and its standard-error only: leave the others out, or --merge shared";
            return bad("layers", text.into());
        }
        if self.layers.windows(2).any(|w| w[0] >= w[1]) {
            return bad("layers", "each layer may be named once".into());
        }
        Ok(())
    }

    /// Checks what depends on the method: layers it has, and settings that contradict each other.
    fn validate_for_method(&self) -> Result<(), SettingsError> {
        let bad = |setting, message: String| Err(SettingsError { setting, message });
        self.method.refuse_layers(&self.layers)?;
        if self.adaptive {
            self.method.refuse_unused(&[Setting::Adaptive])?;
            if self.samples < MIN_ADAPTIVE_SAMPLES {
                let n = self.samples;
                let text = "the first of them are to show where the others go";
                return bad("adaptive", format!("needs --samples {MIN_ADAPTIVE_SAMPLES} or more, not {n}: {text}"));
            }
        }
        if self.direct_from_map {
            if self.method != Method::Photon {
                self.method.refuse_unused(&[Setting::DirectFromMap])?;
            }
            if self.final_gather > 0 {
                let n = self.final_gather;
                return bad(
                    "final-gather",
                    format!("{n} with --direct-from-map, which looks at the map itself: leave one out"),
                );
            }
            const PARTS: [Layer; 3] = [Layer::Direct, Layer::Indirect, Layer::Caustic];
            if let Some(layer) = self.layers.iter().find(|l| PARTS.contains(l)) {
                return bad(
                    "layers",
                    format!("with --direct-from-map one map holds all light: there is no {}", layer.name()),
                );
            }
        }
        for (setting, paths) in [("photons", self.photons), ("caustic-photons", self.caustic_photons)] {
            // A round of `vcm` without light paths would leave out strategies that its weights count on.
            let least = u64::from(setting != "photons" || self.method != Method::Vcm);
            if self.method.has_rounds() && (least..u64::from(self.rounds)).contains(&paths) {
                let rounds = self.rounds;
                return bad(
                    setting,
                    format!("{paths} is the total over all rounds: less than one for each of {rounds}"),
                );
            }
        }
        Ok(())
    }

    /// Checks what `mlt` uses.
    fn validate_chains(&self) -> Result<(), SettingsError> {
        let bad = |setting, message: String| Err(SettingsError { setting, message });
        if self.chains == 0 || self.chains > MAX_CHAINS {
            return bad("chains", format!("{} is outside 1 … {MAX_CHAINS}", self.chains));
        }
        if self.mutations == 0 || self.mutations > MAX_MUTATIONS {
            return bad("mutations", format!("{} is outside 1 … {MAX_MUTATIONS}", self.mutations));
        }
        if self.bootstrap == 0 || self.bootstrap > MAX_BOOTSTRAP {
            return bad("bootstrap", format!("{} is outside 1 … {MAX_BOOTSTRAP}", self.bootstrap));
        }
        if !(self.large_step > 0.0 && self.large_step <= 1.0) {
            return bad("large-step", format!("{} is not above 0 and at most 1", self.large_step));
        }
        Ok(())
    }

    /// Whether whole rounds are computed apart and only their images meet.
    pub fn has_independent_rounds(&self) -> bool {
        self.method.has_rounds() && self.merge == Merge::Independent
    }

    /// Rounds that the image is the mean of, ≥ 1. Methods without rounds of their own take what they have many of (camera samples,
    /// chains, whole rounds computed by one worker) in several of them, so that their noise is known while they run and they
    /// can end early: one for each [`Pass`].
    pub fn image_rounds(&self) -> u32 {
        if self.merges_rounds() { self.rounds } else { self.passes().count().max(1) as u32 }
    }
    /// Whether the rounds of the image are those of the method, each with maps of its own.
    pub fn merges_rounds(&self) -> bool {
        self.method.has_rounds() && self.merge == Merge::Shared
    }
    /// Number of paths that round `round` emits of `total` over all rounds: as equal as integers allow.
    pub fn share_of_round(&self, total: u64, round: u32) -> u64 {
        self.paths_before_round(total, round + 1) - self.paths_before_round(total, round)
    }

    /// Number of paths that the rounds before `round` emit of `total` over all rounds.
    pub fn paths_before_round(&self, total: u64, round: u32) -> u64 {
        (u128::from(total) * u128::from(round) / u128::from(self.rounds.max(1))) as u64
    }
}
