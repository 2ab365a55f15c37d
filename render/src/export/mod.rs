//! Images as files: EXR and a PNG preview, as bytes.

pub mod exr;
pub mod exr_read;
pub mod metadata;
pub mod png;

pub use self::exr::encode;
pub use exr_read::decode;
pub use metadata::{ImageMetadata, MapMetadata};
