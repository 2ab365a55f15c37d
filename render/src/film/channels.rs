//! Which channels an image has, in file order.

use crate::settings::Layer;
use serde::{Deserialize, Serialize};

/// The channels of an image: colour `R G B A` first, then those of each requested layer.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ChannelSet {
    layers: Vec<Layer>,
}

impl ChannelSet {
    /// Colour and `layers` (sorted, without duplicates).
    pub fn new(layers: &[Layer]) -> Self {
        let mut layers = layers.to_vec();
        layers.sort_unstable();
        layers.dedup();
        ChannelSet { layers }
    }
    /// Colour and those of `layers` that tiles hold: not those that are made of whole images.
    pub fn of_tiles(layers: &[Layer]) -> Self {
        let layers: Vec<Layer> = layers.iter().copied().filter(|l| !l.is_of_image()).collect();
        ChannelSet::new(&layers)
    }
    /// The layers beside the colour.
    pub fn layers(&self) -> &[Layer] {
        &self.layers
    }
    /// Number of floats per pixel.
    pub fn len(&self) -> usize {
        4 + self.layers.iter().map(|l| l.width()).sum::<usize>()
    }
    /// Never true: colour is always there.
    pub fn is_empty(&self) -> bool {
        false
    }
    /// Index of the first channel of `layer`, where it is there.
    pub fn offset(&self, layer: Layer) -> Option<usize> {
        let mut at = 4;
        for &l in &self.layers {
            if l == layer {
                return Some(at);
            }
            at += l.width();
        }
        None
    }
    /// EXR names in order: `R`, `G`, `B`, `A`, `direct.R`, …
    pub fn names(&self) -> Vec<String> {
        let mut names: Vec<String> = ["R", "G", "B", "A"].map(String::from).to_vec();
        for l in &self.layers {
            names.extend(l.channel_names().iter().map(|c| format!("{}.{c}", l.name())));
        }
        names
    }
}
