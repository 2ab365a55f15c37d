//! Stiff and extreme scenes with known answers, rendered by the real coordinator and workers: `gatherlight stability`, and
//! small in `cargo test`.
//!
//! A case is a scene, what is special about it, and an answer that comes from outside: a closed form, an exact scaling
//! relation, or a refusal that is right. Every method that applies renders it with one worker and with three. Right is: the
//! same bits from both, no sample that is not finite, and the answer within the interval that the spread over independent
//! seeds gives, which must be narrow enough to see an error. See docs/range.md for what follows from them.

mod cases;
mod glb;
mod run;
mod settings;

pub use cases::cases;
pub use run::{Outcome, Verdict, run};

use gatherlight_render::import::SceneBundle;
use gatherlight_render::settings::Method;

/// Gather radius in scenes whose rooms are 2 wide.
const RADIUS: f64 = 0.05;

/// How much work a run puts into each case.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Effort {
    /// Independent images of each case and method, ≥ 4.
    pub seeds: u32,
    /// Factor on samples, rounds and photons.
    pub factor: u32,
    /// Half the interval around what is got must be narrower than this share of what is expected.
    pub resolution: f64,
    /// Cases that are too large for a test are run too.
    pub large: bool,
}

impl Effort {
    /// For `cargo test`.
    pub const SMALL: Effort = Effort { seeds: 6, factor: 1, resolution: 0.25, large: false };
    /// For the command.
    pub const FULL: Effort = Effort { seeds: 16, factor: 2, resolution: 0.1, large: true };
}

/// One scene with its answer.
#[derive(Clone, Debug)]
pub struct Case {
    /// Its name.
    pub name: String,
    /// What is special about it, in a line.
    pub what: &'static str,
    /// The scene.
    pub scene: SceneBundle,
    /// The scene's unit, for lengths among the settings.
    pub scale: f64,
    /// Pixels along each side.
    pub side: u32,
    /// The answer.
    pub answer: Answer,
    /// Methods that do not apply, each with the reason.
    pub leaves_out: Vec<(Method, &'static str)>,
    /// Methods that cannot meet the answer, each with the reason; they are run and shown, and fail nothing.
    pub limits: Vec<(Method, &'static str)>,
    /// Factor on the samples: scenes whose light is hard to find need more.
    pub samples: u32,
    /// Photon paths, where the case says how many; else the usual number.
    pub photons: Option<u64>,
    /// Gather radius of the first round of `progressive` and `vcm`, in the scene's unit.
    pub radius: f64,
    /// A text that one of the warnings must contain.
    pub warning: Option<&'static str>,
    /// Too large for a test.
    pub large: bool,
}

/// What must come out.
#[derive(Clone, Debug)]
pub enum Answer {
    /// The mean radiance of the image.
    Mean {
        /// Radiance.
        radiance: f64,
        /// Relative slack of every method: the width of a pixel, rounding.
        slack: f64,
        /// Relative slack of methods that read photon maps: the blur and the edges of their discs.
        blur: f64,
    },
    /// The bits of another scene's image, times a power of two.
    SameBits {
        /// The other scene.
        of: SceneBundle,
        /// Its unit.
        scale: f64,
        /// The power of two.
        factor: f32,
    },
    /// Every pixel is 0.
    Black,
    /// The scene is refused, and the message contains this.
    Refused(&'static str),
}

impl Case {
    fn new(name: impl Into<String>, what: &'static str, scene: glb::Glb, answer: Answer) -> Self {
        let (name, scale) = (name.into(), scene.scale());
        Case {
            scene: scene.bundle(&name),
            name,
            what,
            scale,
            side: 1,
            answer,
            leaves_out: Vec::new(),
            limits: Vec::new(),
            samples: 1,
            photons: None,
            radius: RADIUS,
            warning: None,
            large: false,
        }
    }
    fn side(self, side: u32) -> Self {
        Case { side, ..self }
    }
    fn samples(self, samples: u32) -> Self {
        Case { samples, ..self }
    }
    fn photons(self, photons: u64) -> Self {
        Case { photons: Some(photons), ..self }
    }
    fn radius(self, radius: f64) -> Self {
        Case { radius, ..self }
    }
    fn warns(self, text: &'static str) -> Self {
        Case { warning: Some(text), ..self }
    }
    fn large(self) -> Self {
        Case { large: true, ..self }
    }
    fn without(mut self, methods: &[Method], why: &'static str) -> Self {
        self.leaves_out.extend(methods.iter().map(|&m| (m, why)));
        self
    }
    fn limited(mut self, methods: &[Method], why: &'static str) -> Self {
        self.limits.extend(methods.iter().map(|&m| (m, why)));
        self
    }

    /// Whether `method` applies.
    pub fn applies(&self, method: Method) -> bool {
        self.leaves_out.iter().all(|(m, _)| *m != method)
    }
    /// Why `method` cannot meet the answer, if it cannot.
    pub fn limit(&self, method: Method) -> Option<&'static str> {
        self.limits.iter().find(|(m, _)| *m == method).map(|(_, why)| *why)
    }
}
