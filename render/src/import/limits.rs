//! Every limit of the importer, in one place. A file over a limit is refused before the memory is taken.

/// Bytes of JSON text (embedded base64 buffers included).
pub const MAX_JSON_BYTES: usize = 512 << 20;
/// Values in the JSON text; a parsed value takes about 32 bytes.
pub const MAX_JSON_VALUES: usize = 8 << 20;
/// Triangles, and vertices, that any file may unfold to, however small it is.
pub const BASE_ELEMENTS: u64 = 4 << 20;
/// Further triangles, and vertices, allowed for each byte of the file and its buffers. A vertex takes 12 bytes and more,
/// so only a file that lists the same data more than a dozen times reaches this.
pub const ELEMENTS_PER_BYTE: u64 = 1;
/// Pixels of one image.
pub const MAX_IMAGE_PIXELS: u64 = 16_384 * 16_384;
/// Pixels of all images together; a pixel takes 4 bytes.
pub const MAX_TOTAL_PIXELS: u64 = 1 << 29;
/// A deflate stream unfolds at most this many times; a PNG that claims more is damaged or hostile.
pub const MAX_DEFLATE_RATIO: u64 = 1032;
/// Pixels that a byte of a JPEG can hold: a block of 8 × 8 takes at least one bit, however the scans are arranged.
pub const MAX_JPEG_PIXELS_PER_BYTE: u64 = 512;
/// Warnings kept; that there are more is said.
pub const MAX_WARNINGS: usize = 64;
/// Characters of a name or URI quoted in a message.
pub const MAX_QUOTED_CHARS: usize = 80;
