//! Jobs that splat: what they send has to fit.

use super::RenderSettings;
use crate::error::SettingsError;

/// Most pixels of a light image, of all its planes together: it travels whole, a pixel in up to some 27 bytes, and a result takes at most
/// a gibibyte.
const MAX_LIGHT_PIXELS: u64 = 39_000_000;

impl RenderSettings {
    /// Checks that what is splatted can travel.
    pub(super) fn validate_light_image(&self) -> Result<(), SettingsError> {
        let (planes, pixels) = (self.light_planes(), u64::from(self.width) * u64::from(self.height));
        if u64::from(planes) * pixels <= MAX_LIGHT_PIXELS {
            return Ok(());
        }
        let of_planes = if planes > 1 { format!(" in each of {planes} planes") } else { String::new() };
        let message = format!(
            "{} × {} pixels{of_planes} are too many for what this job splats, which travels whole: at most {MAX_LIGHT_PIXELS} together",
            self.width, self.height
        );
        Err(SettingsError { setting: "width", message })
    }
}

#[cfg(test)]
mod tests {
    use crate::settings::{Merge, Method, RenderSettings};

    #[test]
    fn images_of_8k_are_splatted_and_none_that_cannot_travel() {
        let sized = |method, width, height| RenderSettings { width, height, ..RenderSettings::for_method(method) };
        for method in [Method::Bdpt, Method::Mlt, Method::Vcm] {
            assert_eq!(sized(method, 7_680, 4_320).validate(), Ok(()), "{method:?}");
            let refused = sized(method, 8_192, 8_192).validate().expect_err("is too large");
            assert_eq!(refused.setting, "width", "{method:?}");
        }
        assert_eq!(sized(Method::Path, 16_384, 16_384).validate(), Ok(()));
        // Whole rounds bring their alpha.
        let independent = RenderSettings { merge: Merge::Independent, ..sized(Method::Progressive, 7_680, 4_320) };
        assert!(independent.validate().is_err());
    }
}
