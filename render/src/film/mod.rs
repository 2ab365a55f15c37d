//! Images in the making: tiles, the film they are assembled on, and how to compare images.

pub mod channels;
pub mod compare;
pub mod image;
pub mod tile;

pub use channels::ChannelSet;
pub use image::Image;
pub use tile::{Film, Tile, TileGrid, TileRect};
