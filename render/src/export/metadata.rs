//! What an image file says about how it was made: everything that determines its pixels, and nothing that does not
//! (no times, hosts or threads), so that equal jobs give equal files.

use crate::photon::MapKind;
use crate::settings::{CameraChoice, Estimator, Kernel, RenderSettings};

/// Prefix of every attribute Gatherlight writes.
pub const ATTRIBUTE_PREFIX: &str = "gatherlight:";

/// One photon map as it was used.
#[derive(Clone, Debug, PartialEq)]
pub struct MapMetadata {
    /// Which map.
    pub kind: MapKind,
    /// Photon paths emitted: the divisor of every estimate.
    pub emitted_count: u64,
    /// Photons stored.
    pub stored_count: u64,
    /// Neighbours of a density estimate as used, where the map is searched by count.
    pub k: Option<u32>,
    /// Largest gather radius as used, in world units.
    pub max_gather_radius: Option<f32>,
}

/// How an image was made.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageMetadata {
    /// Digest of the scene, as text.
    pub scene_digest: String,
    /// The settings, defaults filled in.
    pub settings: RenderSettings,
    /// The photon maps that were used.
    pub maps: Vec<MapMetadata>,
    /// Lines of the plan: what was computed and what was left out, with the reason; may be empty.
    pub plan: Vec<String>,
    /// Samples and splats left out because they were not finite.
    pub non_finite: u64,
    /// Rounds the image is the mean of, where the method has rounds.
    pub rounds: Option<u32>,
    /// Units of the splat phase it is the mean of, where the method has one: Markov chains, or whole rounds.
    pub units: Option<u64>,
}

impl ImageMetadata {
    /// Attribute names (with prefix, shorter than 32 bytes, sorted) and values.
    pub fn attributes(&self) -> Vec<(String, String)> {
        let s = &self.settings;
        let mut list = vec![
            ("version".to_string(), crate::VERSION.to_string()),
            ("scene_digest".into(), self.scene_digest.clone()),
            ("method".into(), s.method.name().into()),
            ("seed".into(), s.seed.to_string()),
            ("settings".into(), settings_text(s)),
            ("non_finite".into(), self.non_finite.to_string()),
        ];
        list.extend(self.rounds.map(|n| ("rounds".into(), n.to_string())));
        list.extend(self.units.map(|n| ("units".into(), n.to_string())));
        if !self.plan.is_empty() {
            list.push(("plan".into(), self.plan.join("\n")));
        }
        for map in &self.maps {
            let name = map.kind.name();
            list.push((format!("{name}.emitted"), map.emitted_count.to_string()));
            list.push((format!("{name}.stored"), map.stored_count.to_string()));
            list.extend(map.k.map(|k| (format!("{name}.k"), k.to_string())));
            list.extend(map.max_gather_radius.map(|r| (format!("{name}.max_radius"), r.to_string())));
        }
        for entry in &mut list {
            entry.0.insert_str(0, ATTRIBUTE_PREFIX);
        }
        list.sort();
        list
    }
}

/// The settings as the command-line options that give them.
pub fn settings_text(s: &RenderSettings) -> String {
    let mut text = format!("--method {} --width {} --height {}", s.method.name(), s.width, s.height);
    let mut add = |option: &str, value: String| {
        text.push_str(" --");
        text.push_str(option);
        text.push(' ');
        text.push_str(&value);
    };
    match &s.camera {
        CameraChoice::First => {}
        CameraChoice::Index(i) => add("camera", i.to_string()),
        CameraChoice::Name(n) => add("camera", format!("{n:?}")),
    }
    add("samples", s.samples.to_string());
    add("seed", s.seed.to_string());
    if let Some(depth) = s.max_depth {
        add("max-depth", depth.to_string());
    }
    add("photons", s.photons.to_string());
    add("caustic-photons", s.caustic_photons.to_string());
    add("k", s.k.to_string());
    if let Some(radius) = s.max_radius {
        add("max-radius", radius.to_string());
    }
    add("final-gather", s.final_gather.to_string());
    add("estimator", estimator_name(s.estimator).into());
    add("kernel", kernel_name(s.kernel).into());
    if !s.layers.is_empty() {
        add("layers", s.layers.iter().map(|l| l.name()).collect::<Vec<_>>().join(","));
    }
    text
}

/// Name of an estimator on the command line.
pub const fn estimator_name(estimator: Estimator) -> &'static str {
    match estimator {
        Estimator::KdTree => "kdtree",
        Estimator::Hash => "hash",
    }
}

/// Name of a kernel on the command line.
pub const fn kernel_name(kernel: Kernel) -> &'static str {
    match kernel {
        Kernel::Constant => "constant",
        Kernel::Cone => "cone",
        Kernel::Epanechnikov => "epanechnikov",
    }
}
