//! Images in the making: tiles, the film they are assembled on, and how to compare images.

pub mod accumulator;
pub mod blur;
pub mod channels;
pub mod compare;
pub mod image;
pub mod light_image;
pub mod map_error;
mod relative;
pub mod sample_map;
mod standard_error;
pub mod tile;

pub use accumulator::{Accumulator, Brightness, Noise};
pub use blur::{Bias, Blur};
pub use channels::ChannelSet;
pub use image::Image;
pub use light_image::LightImage;
pub use map_error::MapError;
pub use sample_map::SampleMap;
pub use tile::{Film, Tile, TileError, TileGrid, TileRect};
