//! PNG and JPEG images → 8-bit RGBA.

use super::buffer::{Buffers, Files, View};
use super::document::{Document, Warnings};
use super::json::{Item, Result, quoted};
use super::limits::{MAX_DEFLATE_RATIO, MAX_IMAGE_PIXELS, MAX_JPEG_PIXELS_PER_BYTE, MAX_TOTAL_PIXELS};
use super::uri;
use crate::scene::description::ImageDescription;
use ::image::codecs::png::PngDecoder;
use ::image::{DynamicImage, ImageDecoder, Limits};
use std::borrow::Cow;
use std::io::Cursor;
use std::sync::Arc;
use zune_jpeg::zune_core::bytestream::ZCursor;
use zune_jpeg::zune_core::colorspace::ColorSpace;
use zune_jpeg::zune_core::options::DecoderOptions;

const PNG_MAGIC: &[u8] = b"\x89PNG\r\n\x1a\n";
const JPEG_MAGIC: &[u8] = b"\xff\xd8\xff";

/// Decodes the images with the given indices.
///
/// # Errors
/// Names the image that is missing, neither PNG nor JPEG, damaged, or too large.
pub(super) fn read_all(
    doc: &Document,
    images: &[usize],
    views: &[View],
    buffers: &Buffers,
    externals: &[(String, Arc<[u8]>)],
    warnings: &mut Warnings,
) -> Result<Vec<ImageDescription>> {
    let mut pixels = 0u64;
    let mut out = Vec::with_capacity(images.len());
    for &index in images {
        let item = doc.item("images", index)?;
        let name = doc.label("image", "images", index);
        let (declared, bytes) = encoded(doc, &item, views, buffers, externals)?;
        let decoder = Decoder::open(&item, &name, declared, &bytes, warnings)?;
        let (width, height) = decoder.size();
        let size = u64::from(width) * u64::from(height);
        pixels += size;
        if size > MAX_IMAGE_PIXELS {
            return Err(item.limit("the number of its pixels", size, MAX_IMAGE_PIXELS, "use a smaller image"));
        }
        if pixels > MAX_TOTAL_PIXELS {
            return Err(item.limit(
                "the number of pixels of all images so far",
                pixels,
                MAX_TOTAL_PIXELS,
                "use smaller images",
            ));
        }
        let rgba = decoder.decode(&item, &name, warnings)?;
        if width == 0 || height == 0 || rgba.len() as u64 != size * 4 {
            return Err(item.error("the image has no pixels"));
        }
        out.push(ImageDescription { name, width, height, rgba });
    }
    Ok(out)
}

/// Pixels of an image that is not decoded, where its bytes are here and their header makes sense.
pub(super) fn pixels_of(doc: &Document, image: usize, views: &[View], files: Files) -> Option<u64> {
    let item = doc.item("images", image).ok()?;
    let (name, warnings) = (doc.label("image", "images", image), &mut Warnings::default());
    let view = doc.reference(&item, "bufferView", "bufferViews").ok()?;
    let bytes = match view {
        // Only the binary chunk is here without being asked for.
        Some(view) if files.cut.is_none() => {
            let range = views.get(view).map(View::range).filter(|r| r.buffer == 0)?;
            Cow::Borrowed(files.binary?.get(range.offset..range.offset.checked_add(range.length)?)?)
        }
        Some(_) => return None,
        None => {
            let uri_item = item.get("uri").ok()??;
            let uri = uri_item.text().ok()?;
            match uri::is_data(uri) {
                true => Cow::Owned(uri::decode_data(&uri_item, uri).ok()?.1),
                false => Cow::Borrowed(uri::find_external(&uri_item, uri, files.externals).ok()?.1),
            }
        }
    };
    let (width, height) = Decoder::open(&item, &name, None, &bytes, warnings).ok()?.size();
    Some(u64::from(width) * u64::from(height))
}

/// Declared media type and encoded bytes.
fn encoded<'b>(
    doc: &Document<'b>,
    item: &Item<'b>,
    views: &[View],
    buffers: &'b Buffers,
    externals: &'b [(String, Arc<[u8]>)],
) -> Result<(Option<&'b str>, Cow<'b, [u8]>)> {
    let declared = item.opt("mimeType", Item::text)?;
    let uri_item = item.get("uri")?;
    match (doc.reference(item, "bufferView", "bufferViews")?, uri_item) {
        (Some(_), Some(_)) => Err(item.error("has both a uri and a bufferView; only one is allowed")),
        (None, None) => Err(item.error("has neither a uri nor a bufferView")),
        (Some(view), None) => {
            let view = views.get(view).ok_or_else(|| item.error("its buffer view does not exist"))?;
            Ok((declared, Cow::Borrowed(buffers.bytes(view.range()))))
        }
        (None, Some(uri_item)) => {
            let uri = uri_item.text()?;
            if uri::is_data(uri) {
                let (media, bytes) = uri::decode_data(&uri_item, uri)?;
                return Ok((declared.or(Some(media).filter(|m| !m.is_empty())), Cow::Owned(bytes)));
            }
            Ok((declared, Cow::Borrowed(uri::find_external(&uri_item, uri, externals)?.1)))
        }
    }
}

enum Decoder<'b> {
    Png(Box<PngDecoder<Cursor<&'b [u8]>>>),
    Jpeg { bytes: &'b [u8], width: u32, height: u32 },
}

impl<'b> Decoder<'b> {
    /// Reads the header only.
    fn open(item: &Item, name: &str, declared: Option<&str>, bytes: &'b [u8], warnings: &mut Warnings) -> Result<Self> {
        let (media, decoder) = if bytes.starts_with(PNG_MAGIC) {
            ("image/png", Decoder::png(item, bytes)?)
        } else if bytes.starts_with(JPEG_MAGIC) {
            ("image/jpeg", Decoder::jpeg(item, bytes)?)
        } else {
            let declared = declared.map_or(String::new(), |d| format!(" (declared as {})", quoted(d)));
            return Err(item.error(format!("the image is neither PNG nor JPEG{declared}; convert it to one of these")));
        };
        if let Some(declared) = declared.filter(|d| *d != media && *d != "image/jpg") {
            warnings
                .add(format!("{name} is declared as {} but holds {media}; read as what it holds", quoted(declared)));
        }
        Ok(decoder)
    }

    fn png(item: &Item, bytes: &'b [u8]) -> Result<Self> {
        let mut limits = Limits::no_limits();
        limits.max_alloc = Some(MAX_IMAGE_PIXELS * 8);
        let decoder = PngDecoder::with_limits(Cursor::new(bytes), limits).map_err(|e| damaged(item, "PNG", e))?;
        // The header is not to be trusted with memory: what it promises must be able to come out of these bytes.
        let (width, height) = decoder.dimensions();
        let bits = u64::from(decoder.original_color_type().bits_per_pixel());
        let promised = (u64::from(width) * bits).div_ceil(8).saturating_mul(u64::from(height));
        let possible = (bytes.len() as u64).saturating_mul(MAX_DEFLATE_RATIO);
        plausible(item, "PNG", (width, height), promised <= possible, bytes)?;
        Ok(Decoder::Png(Box::new(decoder)))
    }

    fn jpeg(item: &Item, bytes: &'b [u8]) -> Result<Self> {
        let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), jpeg_options(false));
        decoder.decode_headers().map_err(|e| damaged(item, "JPEG", e))?;
        let (width, height) = decoder.dimensions().ok_or_else(|| damaged(item, "JPEG", "it has no size"))?;
        let (width, height) = (width as u32, height as u32);
        let possible = (bytes.len() as u64).saturating_mul(MAX_JPEG_PIXELS_PER_BYTE);
        plausible(item, "JPEG", (width, height), u64::from(width) * u64::from(height) <= possible, bytes)?;
        Ok(Decoder::Jpeg { bytes, width, height })
    }

    fn size(&self) -> (u32, u32) {
        match self {
            Decoder::Png(decoder) => decoder.dimensions(),
            Decoder::Jpeg { width, height, .. } => (*width, *height),
        }
    }

    /// RGBA, row 0 at the top.
    fn decode(self, item: &Item, name: &str, warnings: &mut Warnings) -> Result<Vec<u8>> {
        match self {
            Decoder::Png(decoder) => {
                let image = DynamicImage::from_decoder(*decoder).map_err(|e| damaged(item, "PNG", e))?;
                Ok(image.into_rgba8().into_raw())
            }
            Decoder::Jpeg { bytes, .. } => decode_jpeg(bytes, true).or_else(|strict| {
                let rgba = decode_jpeg(bytes, false).map_err(|_| damaged(item, "JPEG", &strict))?;
                warnings.add(format!("{name}: the JPEG is damaged ({strict}); shown as far as it can be read"));
                Ok(rgba)
            }),
        }
    }
}

/// `zune-jpeg` is built without its vector code, whose results may differ from one machine to the next.
fn decode_jpeg(bytes: &[u8], strict: bool) -> std::result::Result<Vec<u8>, String> {
    let mut decoder = zune_jpeg::JpegDecoder::new_with_options(ZCursor::new(bytes), jpeg_options(strict));
    decoder.decode().map_err(|e| format!("{e:?}"))
}

fn jpeg_options(strict: bool) -> DecoderOptions {
    DecoderOptions::new_safe()
        .set_strict_mode(strict)
        .set_max_width(usize::MAX)
        .set_max_height(usize::MAX)
        .jpeg_set_out_colorspace(ColorSpace::RGBA)
}

fn plausible(item: &Item, format: &str, (width, height): (u32, u32), fits: bool, bytes: &[u8]) -> Result<()> {
    let length = bytes.len();
    let message =
        format!("the {format} says {width} × {height} pixels, more than its {length} bytes can hold: it is damaged");
    if fits { Ok(()) } else { Err(item.error(message)) }
}

fn damaged(item: &Item, format: &str, why: impl std::fmt::Display) -> crate::error::SceneError {
    item.error(format!("the {format} is damaged: {why}"))
}
