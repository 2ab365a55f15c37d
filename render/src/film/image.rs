//! An image as read from a file: named channels of floats, whatever program wrote them.

use super::Film;
use crate::error::ImageError;
use crate::math::Rgb;
use std::collections::BTreeMap;

/// A decoded image.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Image {
    /// Pixels across, ≥ 1.
    pub width: usize,
    /// Pixels down, ≥ 1.
    pub height: usize,
    /// Name and `width × height` values of each channel, row by row from the top, in file order.
    pub channels: Vec<(String, Vec<f32>)>,
    /// Text and number attributes of the header, by name.
    pub attributes: BTreeMap<String, String>,
}

impl Image {
    /// The values of the channel called exactly `name`.
    pub fn channel(&self, name: &str) -> Option<&[f32]> {
        self.channels.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_slice())
    }

    /// The image's colour: channels `R G B` (any case), else those of the first layer that has all three
    /// (`ViewLayer.Combined.R` …), else luminance `Y` as grey.
    ///
    /// # Errors
    /// [`ImageError::Shape`], naming the channels there are, when none of these exist.
    pub fn rgb(&self) -> Result<Vec<Rgb>, ImageError> {
        let (r, g, b) = self.color_channels().ok_or_else(|| {
            let names: Vec<&str> = self.channels.iter().map(|(n, _)| n.as_str()).collect();
            ImageError::Shape(format!("no colour channels R, G, B or Y among {}", names.join(", ")))
        })?;
        Ok(r.iter().zip(g).zip(b).map(|((&r, &g), &b)| Rgb::new(r, g, b)).collect())
    }

    fn color_channels(&self) -> Option<(&[f32], &[f32], &[f32])> {
        let find = |prefix: &str, suffix: &str| {
            let matches = |n: &str| {
                n.strip_prefix(prefix).is_some_and(|rest| {
                    rest.eq_ignore_ascii_case(suffix)
                        || (rest.len() > 1 && rest.eq_ignore_ascii_case(long_name(suffix)))
                })
            };
            self.channels.iter().find(|(n, _)| matches(n)).map(|(_, v)| v.as_slice())
        };
        let triple = |prefix: &str| Some((find(prefix, "R")?, find(prefix, "G")?, find(prefix, "B")?));
        let prefixes = || self.channels.iter().filter_map(|(n, _)| n.rfind('.').map(|at| &n[..=at]));
        triple("")
            .or_else(|| prefixes().find_map(triple))
            .or_else(|| find("", "Y").map(|y| (y, y, y)))
            .or_else(|| prefixes().find_map(|p| find(p, "Y")).map(|y| (y, y, y)))
    }
}

fn long_name(suffix: &str) -> &'static str {
    match suffix {
        "R" => "red",
        "G" => "green",
        "B" => "blue",
        _ => "luminance",
    }
}

impl Film {
    /// The film's colour, row by row from the top.
    pub fn rgb(&self) -> Vec<Rgb> {
        self.pixels.chunks_exact(self.channels.len()).map(|p| Rgb::new(p[0], p[1], p[2])).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(names: &[&str]) -> Image {
        let channels = names.iter().enumerate().map(|(i, n)| (n.to_string(), vec![i as f32])).collect();
        Image { width: 1, height: 1, channels, ..Default::default() }
    }

    #[test]
    fn colour_is_found_under_the_names_other_programs_use() {
        let first = |names: &[&str]| image(names).rgb().unwrap()[0];
        assert_eq!(first(&["A", "B", "G", "R"]), Rgb::new(3.0, 2.0, 1.0));
        assert_eq!(first(&["b", "g", "r"]), Rgb::new(2.0, 1.0, 0.0));
        assert_eq!(first(&["blue", "green", "red"]), Rgb::new(2.0, 1.0, 0.0));
        let blender = ["V.Combined.A", "V.Combined.B", "V.Combined.G", "V.Combined.R", "V.Depth.Z"];
        assert_eq!(first(&blender), Rgb::new(3.0, 2.0, 1.0));
        assert_eq!(first(&["Y"]), Rgb::splat(0.0));
        // Plain names win over a layer's, wherever they stand.
        assert_eq!(first(&["albedo.R", "albedo.G", "albedo.B", "B", "G", "R"]), Rgb::new(5.0, 4.0, 3.0));
    }

    #[test]
    fn no_colour_names_what_is_there() {
        let message = image(&["Z", "normal.X"]).rgb().unwrap_err().to_string();
        assert!(message.contains("Z, normal.X"), "{message}");
    }
}
