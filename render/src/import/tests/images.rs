//! Image decoding and its refusals.

use super::builder::{Builder, png};
use serde_json::{Value, json};

fn with_image(bytes: &[u8], mime: &str) -> Builder {
    let mut b = Builder::with_material(json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 } } }));
    b.texture(bytes, mime);
    b.attribute("TEXCOORD_0", super::builder::F32, "VEC2", 4, &[0; 32]);
    b
}

#[test]
fn png_pixels_arrive_exactly() {
    let pixels: Vec<u8> = (0..3 * 2 * 4).map(|i| (i * 11) as u8).collect();
    let scene = with_image(&png(3, 2, &pixels), "image/png").clean_scene();
    let image = &scene.images[0];
    assert_eq!((image.width, image.height, image.name.as_str()), (3, 2, "images[0]"));
    assert_eq!(image.rgba, pixels);
}

#[test]
fn other_png_kinds_become_rgba() {
    let encode = |kind: image::ExtendedColorType, bytes: &[u8]| {
        let mut out = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut out);
        image::ImageEncoder::write_image(encoder, bytes, 1, 1, kind).expect("a PNG");
        with_image(&out, "image/png").clean_scene().images.remove(0).rgba
    };
    use image::ExtendedColorType::{L8, La8, Rgb8, Rgb16};
    assert_eq!(encode(L8, &[7]), [7, 7, 7, 255]);
    assert_eq!(encode(La8, &[7, 8]), [7, 7, 7, 8]);
    assert_eq!(encode(Rgb8, &[1, 2, 3]), [1, 2, 3, 255]);
    let sixteen: Vec<u8> = [0x0101u16, 0x8080, 0xffff].iter().flat_map(|v| v.to_ne_bytes()).collect();
    assert_eq!(encode(Rgb16, &sixteen), [1, 128, 255, 255]);
}

/// Decoders may round inverse transforms and colour conversion differently; libjpeg's chroma upsampling is the
/// triangle filter that `zune-jpeg` has too. Worst differences seen between libjpeg versions are of this size.
const JPEG_TOLERANCE: u8 = 4;

#[test]
fn jpeg_pixels_agree_with_libjpeg() {
    let cases: [(&str, &[u8], &[u8]); 3] = [
        ("baseline", include_bytes!("data/baseline.jpg"), include_bytes!("data/baseline.rgb")),
        ("progressive", include_bytes!("data/progressive.jpg"), include_bytes!("data/progressive.rgb")),
        ("gray", include_bytes!("data/gray.jpg"), include_bytes!("data/gray.rgb")),
    ];
    for (name, jpeg, expected) in cases {
        let scene = with_image(jpeg, "image/jpeg").clean_scene();
        let image = &scene.images[0];
        assert_eq!((image.width, image.height, expected.len()), (24, 16, 24 * 16 * 3));
        let mut worst = 0;
        for (pixel, truth) in image.rgba.chunks(4).zip(expected.chunks(3)) {
            assert_eq!(pixel[3], 255);
            worst = pixel.iter().zip(truth).fold(worst, |w, (a, b)| w.max(a.abs_diff(*b)));
        }
        assert!(worst <= JPEG_TOLERANCE, "{name}: {worst}");
    }
}

#[test]
fn images_come_from_files_and_data_uris_too() {
    use base64::Engine as _;
    let bytes = png(1, 1, &[1, 2, 3, 4]);
    let mut b = with_image(&bytes, "image/png");
    let base64 = base64::engine::general_purpose::STANDARD.encode(&bytes);
    b.json["images"][0] = json!({ "uri": format!("data:image/png;base64,{base64}") });
    assert_eq!(b.clean_scene().images[0].rgba, [1, 2, 3, 4]);
    b.json["images"][0] = json!({ "uri": "skin.png" });
    assert_eq!(b.error(), "test.glb: images[0].uri: the external file \"skin.png\" is missing");
    b.externals.push(("skin.png".into(), bytes.into()));
    assert_eq!(b.clean_scene().images[0].rgba, [1, 2, 3, 4]);
    b.json["images"][0] = json!({});
    assert_eq!(b.error(), "test.glb: images[0]: has neither a uri nor a bufferView");
    b.json["images"][0] = json!({ "uri": "skin.png", "bufferView": 0 });
    assert_eq!(b.error(), "test.glb: images[0]: has both a uri and a bufferView; only one is allowed");
}

#[test]
fn wrong_types_are_told() {
    let webp = with_image(b"RIFF\x10\0\0\0WEBPVP8 ", "image/webp").error();
    assert_eq!(
        webp,
        "test.glb: images[0]: the image is neither PNG nor JPEG (declared as \"image/webp\"); convert it to one of these"
    );
    let mislabelled = with_image(&png(1, 1, &[0; 4]), "image/jpeg");
    assert_eq!(
        mislabelled.warning(),
        "images[0] is declared as \"image/jpeg\" but holds image/png; read as what it holds"
    );
}

#[test]
fn image_bombs_are_refused_before_they_unfold() {
    // A PNG header may promise anything; the checksum is right.
    let promise = |width: u32, height: u32| {
        let mut chunk = b"IHDR".to_vec();
        chunk.extend(width.to_be_bytes());
        chunk.extend(height.to_be_bytes());
        chunk.extend([8, 6, 0, 0, 0]);
        let mut bytes = b"\x89PNG\r\n\x1a\n\0\0\0\x0d".to_vec();
        bytes.extend(&chunk);
        bytes.extend(crc32(&chunk).to_be_bytes());
        bytes.extend(b"\0\0\0\x04IDAT\x78\x01\0\0\0\0\0\0");
        with_image(&bytes, "image/png").error()
    };
    let bomb = promise(60_000, 60_000);
    assert!(bomb.starts_with("test.glb: images[0]: the PNG says 60000 × 60000 pixels, more than its"), "{bomb}");
    assert!(promise(0, 5).contains("images[0]: the PNG is damaged"), "{}", promise(0, 5));
    // So may a JPEG's; and with enough bytes behind it, the limit still holds.
    let mut jpeg = include_bytes!("data/baseline.jpg").to_vec();
    let frame = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).expect("a frame header");
    jpeg[frame + 5..frame + 9].copy_from_slice(&[0xff, 0xdc, 0xff, 0xdc]);
    let bomb = with_image(&jpeg, "image/jpeg").error();
    assert!(bomb.contains("images[0]: the JPEG says 65500 × 65500 pixels, more than its 715 bytes can hold"), "{bomb}");
    jpeg.resize(9 << 20, 0);
    assert_eq!(
        with_image(&jpeg, "image/jpeg").error(),
        "test.glb: images[0]: the number of its pixels is 4290250000, over the limit of 268435456; use a smaller image"
    );
}

#[test]
fn damaged_images_are_told_and_never_half_shown_in_silence() {
    let whole = png(16, 16, &[200; 16 * 16 * 4]);
    let cut = with_image(&whole[..whole.len() - 20], "image/png").error();
    assert!(cut.starts_with("test.glb: images[0]: the PNG is damaged: "), "{cut}");
    let jpeg = include_bytes!("data/progressive.jpg");
    let scene = crate::import::load(&with_image(&jpeg[..jpeg.len() / 2], "image/jpeg").bundle());
    match scene {
        Ok(scene) => {
            assert!(scene.warnings.iter().any(|w| w.contains("images[0]: the JPEG is damaged")), "{:?}", scene.warnings)
        }
        Err(error) => assert!(error.to_string().contains("images[0]: the JPEG is damaged"), "{error}"),
    }
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    })
}

#[test]
fn an_image_used_by_two_textures_is_decoded_once() {
    let mut b = with_image(&png(1, 1, &[9; 4]), "image/png");
    b.push("textures", json!({ "source": 0 }));
    b.set("/materials/0/normalTexture", json!({ "index": 1 }));
    let scene = b.clean_scene();
    assert_eq!((scene.textures.len(), scene.images.len()), (2, 1));
    let missing: Value = json!(3);
    assert!(b.but("/textures/1/source", missing).error().contains("textures[1].source: refers to images[3]"));
}
