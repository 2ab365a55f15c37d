//! The options that only some methods use, as flags. Which and with what defaults is the table in
//! `gatherlight_render::settings`; the help texts are made from it.

use super::format::parse_bytes;
use super::settings::{choice, count32, count64};
use clap::Args;
use gatherlight_render::settings::{Estimator, Kernel, Merge, Method, RenderSettings, Setting};

/// Options of methods, unset unless given.
#[derive(Args, Clone, Debug)]
pub(super) struct OptionArgs {
    #[arg(long, value_name = "N", value_parser = count32, help_heading = "Image",
          help = help("Camera samples per pixel", Setting::Samples), hide = unused(Setting::Samples))]
    samples: Option<u32>,
    #[arg(long, help_heading = "Image", hide = unused(Setting::Adaptive),
          help = help("More of the samples where the first of them show more error", Setting::Adaptive))]
    adaptive: bool,
    #[arg(long, value_name = "N", help_heading = "Image",
          help = help("Longest path in edges between camera and light", Setting::MaxDepth),
          hide = unused(Setting::MaxDepth))]
    max_depth: Option<u32>,
    #[command(flatten)]
    photon: PhotonArgs,
    #[command(flatten)]
    rounds: RoundArgs,
    #[command(flatten)]
    chain: ChainArgs,
}

/// Options about photons.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Photons")]
struct PhotonArgs {
    #[arg(long, value_name = "N", value_parser = count64, hide = unused(Setting::Photons),
          help = help("Photon paths emitted for the global map over all rounds, e.g. 500k or 10M", Setting::Photons))]
    photons: Option<u64>,
    #[arg(long, value_name = "N", value_parser = count64, hide = unused(Setting::CausticPhotons),
          help = help("Photon paths emitted for the caustic map over all rounds", Setting::CausticPhotons))]
    caustic_photons: Option<u64>,
    #[arg(long, value_name = "K", value_parser = count32, hide = unused(Setting::K),
          help = help("Photons in one density estimate", Setting::K))]
    k: Option<u32>,
    #[arg(long, value_name = "RADIUS", hide = unused(Setting::MaxRadius),
          help = help("Largest gather radius, or that of the first round, in the scene's units", Setting::MaxRadius))]
    max_radius: Option<f32>,
    #[arg(long, value_name = "N", value_parser = count32, hide = unused(Setting::FinalGather),
          help = help("Final-gather rays per camera sample; 0 looks at the global map directly", Setting::FinalGather))]
    final_gather: Option<u32>,
    #[arg(long, value_parser = choice(&Estimator::ALL, Estimator::name), hide = unused(Setting::Estimator),
          help = help("Search structure: k nearest in a k-d tree, or a fixed radius in a spatial hash", Setting::Estimator))]
    estimator: Option<Estimator>,
    #[arg(long, value_parser = choice(&Kernel::ALL, Kernel::name), hide = unused(Setting::Kernel),
          help = help("Weight of a photon by its distance", Setting::Kernel))]
    kernel: Option<Kernel>,
    #[arg(long, hide = unused(Setting::DirectFromMap),
          help = help("Look at all light in one photon map, direct light too: the plain estimate, as \
                       --direct-from-map --photons 10k --k 50", Setting::DirectFromMap))]
    direct_from_map: bool,
}

/// Options about rounds.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Rounds")]
struct RoundArgs {
    #[arg(long, value_name = "N", value_parser = count32, hide = unused(Setting::Rounds),
          help = help("Rounds: each with photons and one camera sample a pixel of its own", Setting::Rounds))]
    rounds: Option<u32>,
    #[arg(long, value_name = "ALPHA", hide = unused(Setting::RadiusAlpha),
          help = help("How slowly the radius falls from round to round, between 0 and 1", Setting::RadiusAlpha))]
    radius_alpha: Option<f32>,
    #[arg(long, value_parser = choice(&Merge::ALL, Merge::name), hide = unused(Setting::Merge),
          help = help("One map of all workers' photons a round, or rounds computed whole by one worker each", Setting::Merge))]
    merge: Option<Merge>,
    #[arg(long, value_name = "BYTES", value_parser = parse_bytes, hide = unused(Setting::Memory),
          help = help("Memory that the photons of one round may take, e.g. 512M: sets --rounds", Setting::Memory))]
    memory: Option<u64>,
}

/// Options about Markov chains.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Markov chains")]
struct ChainArgs {
    #[arg(long, value_name = "N", value_parser = count32, hide = unused(Setting::Mutations),
          help = help("Mutations per pixel", Setting::Mutations))]
    mutations: Option<u32>,
    #[arg(long, value_name = "N", value_parser = count32, hide = unused(Setting::Chains),
          help = help("Markov chains, the units of distribution, e.g. 1k", Setting::Chains))]
    chains: Option<u32>,
    #[arg(long, value_name = "N", value_parser = count64, hide = unused(Setting::Bootstrap),
          help = help("Paths per path length that find the image's brightness, e.g. 100k", Setting::Bootstrap))]
    bootstrap: Option<u64>,
    #[arg(long, value_name = "P", hide = unused(Setting::LargeStep),
          help = help("Probability of a step that forgets the path before", Setting::LargeStep))]
    large_step: Option<f32>,
}

impl OptionArgs {
    /// The options that are given, in the order of [`Setting::ALL`].
    pub(super) fn given(&self) -> Vec<Setting> {
        let (p, r, c) = (&self.photon, &self.rounds, &self.chain);
        let is_given = |setting: &Setting| match setting {
            Setting::Samples => self.samples.is_some(),
            Setting::Adaptive => self.adaptive,
            Setting::MaxDepth => self.max_depth.is_some(),
            Setting::Photons => p.photons.is_some(),
            Setting::CausticPhotons => p.caustic_photons.is_some(),
            Setting::K => p.k.is_some(),
            Setting::MaxRadius => p.max_radius.is_some(),
            Setting::FinalGather => p.final_gather.is_some(),
            Setting::Estimator => p.estimator.is_some(),
            Setting::Kernel => p.kernel.is_some(),
            Setting::DirectFromMap => p.direct_from_map,
            Setting::Rounds => r.rounds.is_some(),
            Setting::RadiusAlpha => r.radius_alpha.is_some(),
            Setting::Merge => r.merge.is_some(),
            Setting::Memory => r.memory.is_some(),
            Setting::Mutations => c.mutations.is_some(),
            Setting::Chains => c.chains.is_some(),
            Setting::Bootstrap => c.bootstrap.is_some(),
            Setting::LargeStep => c.large_step.is_some(),
        };
        Setting::ALL.into_iter().filter(is_given).collect()
    }

    /// Puts what is given into `s`, which holds the method's defaults, and what follows from it.
    pub(super) fn apply(&self, s: &mut RenderSettings) {
        let (p, r, c) = (&self.photon, &self.rounds, &self.chain);
        set(&mut s.rounds, r.rounds);
        // As many as rounds and pixels make, unless their number is given.
        [s.photons, s.caustic_photons] = s.default_photons();
        set(&mut s.samples, self.samples);
        s.adaptive = self.adaptive;
        s.max_depth = self.max_depth;
        set(&mut s.photons, p.photons);
        set(&mut s.caustic_photons, p.caustic_photons);
        s.divide_photons = s.method == Method::Progressive && p.photons.is_none() && p.caustic_photons.is_none();
        set(&mut s.k, p.k);
        s.max_radius = p.max_radius;
        s.direct_from_map = p.direct_from_map;
        if p.direct_from_map {
            s.final_gather = 0;
        }
        set(&mut s.final_gather, p.final_gather);
        set(&mut s.estimator, p.estimator);
        set(&mut s.kernel, p.kernel);
        set(&mut s.radius_alpha, r.radius_alpha);
        set(&mut s.merge, r.merge);
        set(&mut s.mutations, c.mutations);
        set(&mut s.chains, c.chains);
        set(&mut s.bootstrap, c.bootstrap);
        set(&mut s.large_step, c.large_step);
    }

    /// The bound on the memory of one round's photons, in bytes.
    pub(super) fn memory(&self) -> Option<u64> {
        self.rounds.memory
    }
    /// Whether it is given how much `method` computes. Photons are those of all rounds together, so they say it, too.
    pub(super) fn has_count(&self, method: Method) -> bool {
        let counts: &[Setting] = match method {
            Method::Mlt => &[Setting::Mutations, Setting::Chains],
            m if m.has_rounds() => &[Setting::Rounds, Setting::Photons, Setting::CausticPhotons],
            _ => &[Setting::Samples],
        };
        self.given().iter().any(|s| counts.contains(s))
    }
    /// Whether the number of rounds is given.
    pub(super) fn has_rounds(&self) -> bool {
        self.rounds.rounds.is_some()
    }
}

fn set<T: Copy>(slot: &mut T, given: Option<T>) {
    if let Some(value) = given {
        *slot = value;
    }
}

/// No method that is built uses it.
fn unused(setting: Setting) -> bool {
    setting.methods().next().is_none()
}

/// `text` with the methods that use `setting` and their defaults.
fn help(text: &str, setting: Setting) -> String {
    let defaults: Vec<(&str, String)> = setting.methods().map(|m| (m.name(), default_text(setting, m))).collect();
    let same = defaults.windows(2).all(|w| w[0].1 == w[1].1);
    let methods = match defaults.first() {
        Some((_, default)) if same => {
            let names: Vec<&str> = defaults.iter().map(|(name, _)| *name).collect();
            format!("{}; default: {default}", names.join(", "))
        }
        _ => defaults.iter().map(|(name, default)| format!("{name}: {default}")).collect::<Vec<_>>().join("; "),
    };
    format!("{text} [{methods}]")
}

/// What `setting` is for `method` where nobody says.
fn default_text(setting: Setting, method: Method) -> String {
    match (setting, method) {
        (Setting::Photons, Method::Vcm) => return "one a pixel and round".into(),
        (Setting::MaxDepth, _) => return "unlimited".into(),
        (Setting::MaxRadius, _) => return "from the map's density".into(),
        (Setting::DirectFromMap | Setting::Adaptive, _) => return "off".into(),
        (Setting::Memory, _) => return "unlimited".into(),
        _ => {}
    }
    let text = setting.value(&RenderSettings::for_method(method)).unwrap_or_default();
    match text.parse::<u64>() {
        Ok(n) if n >= 1_000_000 && n.is_multiple_of(100_000) => format!("{}M", n as f64 / 1e6),
        Ok(n) if n >= 10_000 && n.is_multiple_of(1000) => format!("{}k", n / 1000),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn help_names_the_methods_and_their_defaults() {
        assert_eq!(help("N", Setting::K), "N [photon; default: 60]");
        assert!(help("N", Setting::CausticPhotons).contains("1M"));
        let samples = help("N", Setting::Samples);
        assert!(samples.contains("path: 64") && samples.contains("photon: 32"), "{samples}");
        assert!(help("N", Setting::MaxDepth).contains("default: unlimited"));
    }
}
