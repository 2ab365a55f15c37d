//! Render settings.

use super::name;
use crate::error::WireError;
use crate::wire;
use gatherlight_render::settings::{CameraChoice, Estimator, Kernel, Layer, Merge, Method, RenderSettings};

/// Both directions of an enumeration.
macro_rules! enumeration {
    ($domain:ident, $read:ident, $field:literal, $($variant:ident),+) => {
        impl From<$domain> for wire::$domain {
            fn from(value: $domain) -> Self {
                match value {
                    $($domain::$variant => wire::$domain::$variant,)+
                }
            }
        }
        fn $read(value: i32) -> Result<$domain, WireError> {
            match wire::$domain::try_from(value) {
                $(Ok(wire::$domain::$variant) => Ok($domain::$variant),)+
                _ => Err(WireError::invalid($field, format!("{value} is unknown here"))),
            }
        }
    };
}

enumeration!(Method, method, "method", Whitted, Path, Bdpt, Mlt, Photon, Progressive, Vcm);
enumeration!(Merge, merge, "merge", Shared, Independent);
enumeration!(Estimator, estimator, "estimator", KdTree, Hash);
enumeration!(Kernel, kernel, "kernel", Constant, Cone, Epanechnikov);
enumeration!(
    Layer,
    layer,
    "layers",
    Direct,
    Indirect,
    Caustic,
    Albedo,
    Normal,
    Depth,
    Position,
    Variance,
    Samples,
    StandardError,
    Strategies
);

impl From<&RenderSettings> for wire::RenderSettings {
    fn from(s: &RenderSettings) -> Self {
        wire::RenderSettings {
            method: wire::Method::from(s.method).into(),
            width: s.width,
            height: s.height,
            samples: s.samples,
            seed: s.seed,
            adaptive: s.adaptive,
            max_depth: s.max_depth,
            photons: s.photons,
            caustic_photons: s.caustic_photons,
            divide_photons: s.divide_photons,
            k: s.k,
            max_radius: s.max_radius,
            final_gather: s.final_gather,
            estimator: wire::Estimator::from(s.estimator).into(),
            kernel: wire::Kernel::from(s.kernel).into(),
            layers: s.layers.iter().map(|&l| wire::Layer::from(l).into()).collect(),
            direct_from_map: s.direct_from_map,
            rounds: s.rounds,
            radius_alpha: s.radius_alpha,
            merge: wire::Merge::from(s.merge).into(),
            chains: s.chains,
            mutations: s.mutations,
            bootstrap: s.bootstrap,
            large_step: s.large_step,
            keep_all: s.keep_all,
            camera: match &s.camera {
                CameraChoice::First => None,
                CameraChoice::Index(i) => Some(wire::render_settings::Camera::CameraIndex(*i)),
                CameraChoice::Name(n) => Some(wire::render_settings::Camera::CameraName(n.clone())),
            },
        }
    }
}

impl TryFrom<wire::RenderSettings> for RenderSettings {
    type Error = WireError;
    fn try_from(s: wire::RenderSettings) -> Result<Self, WireError> {
        WireError::check_limit("layers", s.layers.len() as u64, Layer::ALL.len() as u64, "number of layers")?;
        let settings = RenderSettings {
            method: method(s.method)?,
            width: s.width,
            height: s.height,
            camera: match s.camera {
                None => CameraChoice::First,
                Some(wire::render_settings::Camera::CameraIndex(i)) => CameraChoice::Index(i),
                Some(wire::render_settings::Camera::CameraName(n)) => CameraChoice::Name(name("camera_name", n)?),
            },
            samples: s.samples,
            seed: s.seed,
            adaptive: s.adaptive,
            max_depth: s.max_depth,
            photons: s.photons,
            caustic_photons: s.caustic_photons,
            divide_photons: s.divide_photons,
            k: s.k,
            max_radius: s.max_radius,
            final_gather: s.final_gather,
            estimator: estimator(s.estimator)?,
            kernel: kernel(s.kernel)?,
            layers: s.layers.into_iter().map(layer).collect::<Result<_, _>>()?,
            keep_all: s.keep_all,
            direct_from_map: s.direct_from_map,
            rounds: s.rounds,
            radius_alpha: s.radius_alpha,
            merge: merge(s.merge)?,
            chains: s.chains,
            mutations: s.mutations,
            bootstrap: s.bootstrap,
            large_step: s.large_step,
        };
        settings.validate().map_err(|e| WireError::invalid("settings", e.to_string()))?;
        Ok(settings)
    }
}
