//! What an image file says about how it was made: everything that determines its pixels, and nothing that does not
//! (no times, hosts or threads), so that equal jobs give equal files.

use crate::film::{Bias, Noise};
use crate::photon::MapKind;
use crate::settings::{CameraChoice, RenderSettings};

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
    /// Camera samples of each pixel that the image is the mean of, where the method has no rounds of its own.
    pub samples: Option<u32>,
    /// Its noise, where it is known.
    pub noise: Option<Noise>,
    /// Its bias, where it is known.
    pub bias: Option<Bias>,
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
        list.extend(self.samples.map(|n| ("samples".into(), n.to_string())));
        if let Some(noise) = self.noise {
            list.push(("standard_error".into(), noise.standard_error.to_string()));
            list.push(("relative_standard_error".into(), noise.relative.to_string()));
        }
        if let Some(bias) = self.bias {
            list.push(("bias".into(), bias.absolute.to_string()));
            list.push(("relative_bias".into(), bias.relative.to_string()));
        }
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

/// The settings as the command-line options that give them: those that the method uses.
pub fn settings_text(s: &RenderSettings) -> String {
    let mut text = format!("--method {} --width {} --height {}", s.method.name(), s.width, s.height);
    let mut add = |option: &str, value: &str| {
        text.push_str(" --");
        text.push_str(option);
        // A switch has no value.
        if !value.is_empty() {
            text.push(' ');
            text.push_str(value);
        }
    };
    match &s.camera {
        CameraChoice::First => {}
        CameraChoice::Index(i) => add("camera", &i.to_string()),
        CameraChoice::Name(n) => add("camera", &format!("{n:?}")),
    }
    add("seed", &s.seed.to_string());
    for setting in s.method.options() {
        if let Some(value) = setting.value(s) {
            add(setting.name(), &value);
        }
    }
    if !s.layers.is_empty() {
        add("layers", &s.layers.iter().map(|l| l.name()).collect::<Vec<_>>().join(","));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Layer, Method};

    #[test]
    fn only_options_that_the_method_uses_are_written() {
        let path = RenderSettings { max_depth: Some(7), seed: 3, ..RenderSettings::for_method(Method::Path) };
        assert_eq!(settings_text(&path), "--method path --width 512 --height 512 --seed 3 --samples 64 --max-depth 7");
        let plain = RenderSettings {
            direct_from_map: true,
            final_gather: 0,
            photons: 10_000,
            k: 50,
            camera: CameraChoice::Index(1),
            layers: vec![Layer::Depth, Layer::Samples],
            ..RenderSettings::default()
        };
        assert_eq!(
            settings_text(&plain),
            "--method photon --width 512 --height 512 --camera 1 --seed 0 --samples 32 --photons 10000 \
             --caustic-photons 1000000 --k 50 --final-gather 0 --estimator kdtree --kernel constant --direct-from-map \
             --layers depth,samples"
        );
    }
}
