//! EXR files: what is written is what was rendered, equal jobs give equal bytes, and no input makes the reader panic.

use exr::prelude::*;
use gatherlight_render::export::{ImageMetadata, MapMetadata, decode, encode};
use gatherlight_render::film::{ChannelSet, Film};
use gatherlight_render::photon::MapKind;
use gatherlight_render::settings::{Layer as ImageLayer, RenderSettings};
use gatherlight_tests::pixel_sha256;
use std::io::Cursor;

fn metadata() -> ImageMetadata {
    ImageMetadata {
        scene_digest: "3f".repeat(32),
        settings: RenderSettings { seed: u64::MAX, ..Default::default() },
        maps: vec![MapMetadata {
            kind: MapKind::Caustic,
            emitted_count: 1 << 40,
            stored_count: 77,
            k: Some(60),
            max_gather_radius: Some(0.1),
        }],
        plan: vec!["caustic map: kept, “glass” refracts".into()],
        non_finite: 3,
        samples: None,
        noise: None,
        bias: None,
        rounds: None,
        units: None,
    }
}

fn film(width: u32, height: u32, layers: &[ImageLayer]) -> Film {
    let mut film = Film::new(width, height, ChannelSet::new(layers));
    for (i, v) in film.pixels.iter_mut().enumerate() {
        // Every bit pattern counts, subnormal and infinite ones too.
        *v = f32::from_bits((i as u32).wrapping_mul(2_654_435_761));
    }
    film
}

#[test]
fn every_channel_comes_back_bit_for_bit() {
    // 37 rows: the last ZIP block of 16 lines is cropped.
    let film = film(53, 37, &ImageLayer::ALL);
    let image = decode(&encode(&film, &metadata()).unwrap()).unwrap();
    assert_eq!((image.width, image.height), (53, 37));
    let names = film.channels.names();
    assert_eq!(image.channels.len(), names.len());
    for (c, name) in names.iter().enumerate() {
        let values = image.channel(name).unwrap_or_else(|| panic!("no {name}"));
        let expected = film.pixels.iter().skip(c).step_by(names.len());
        assert!(values.iter().zip(expected).all(|(a, b)| a.to_bits() == b.to_bits()), "{name}");
    }
}

#[test]
fn the_header_tells_how_the_image_was_made() {
    let image = decode(&encode(&film(4, 4, &[]), &metadata()).unwrap()).unwrap();
    let attribute = |name: &str| image.attributes.get(name).map(String::as_str);
    assert_eq!(attribute("gatherlight:method"), Some("photon"));
    assert_eq!(attribute("gatherlight:seed"), Some("18446744073709551615"));
    assert_eq!(attribute("gatherlight:caustic.emitted"), Some("1099511627776"));
    assert_eq!(attribute("gatherlight:caustic.stored"), Some("77"));
    assert_eq!(attribute("gatherlight:caustic.k"), Some("60"));
    assert_eq!(attribute("gatherlight:caustic.max_radius"), Some("0.1"));
    assert_eq!(attribute("gatherlight:global.emitted"), None);
    assert_eq!(attribute("gatherlight:scene_digest"), Some("3f".repeat(32).as_str()));
    assert_eq!(attribute("gatherlight:plan"), Some("caustic map: kept, “glass” refracts"));
    assert_eq!(attribute("gatherlight:version"), Some(env!("CARGO_PKG_VERSION")));
    assert!(attribute("gatherlight:settings").is_some_and(|s| s.contains("--width 512 --height 512")));
}

#[test]
fn one_part_of_zipped_scan_lines_with_the_full_window() {
    let bytes = encode(&film(20, 9, &[ImageLayer::Depth]), &metadata()).unwrap();
    let meta = MetaData::read_from_buffered(bytes.as_slice(), true).unwrap();
    assert_eq!(meta.headers.len(), 1);
    let header = &meta.headers[0];
    assert_eq!(header.compression, Compression::ZIP16);
    assert!(!header.blocks.has_tiles());
    assert_eq!(header.data_window(), IntegerBounds::from_dimensions((20, 9)));
    assert_eq!(header.shared_attributes.display_window, header.data_window());
    let names: Vec<String> = header.channels.list.iter().map(|c| c.name.to_string()).collect();
    assert_eq!(names, ["A", "B", "G", "R", "depth.Z"]);
    assert!(header.channels.list.iter().all(|c| c.sample_type == SampleType::F32));
}

#[test]
fn equal_jobs_give_equal_bytes() {
    // Attributes come out of a hash map that is seeded anew for every map: eight in a row agree by chance in 1 of 10²⁰.
    let film = film(64, 300, &[]);
    let first = encode(&film, &metadata()).unwrap();
    assert!((0..8).all(|_| encode(&film, &metadata()).unwrap() == first));
}

#[test]
fn the_pixel_digest_sees_one_bit_and_not_the_metadata() {
    let mut film = film(8, 8, &[]);
    let digest = |film: &Film, meta: &ImageMetadata| pixel_sha256(&encode(film, meta).unwrap());
    let first = digest(&film, &metadata());
    assert_eq!(first, digest(&film, &ImageMetadata { non_finite: 0, ..metadata() }));
    film.pixels[101] = f32::from_bits(film.pixels[101].to_bits() ^ 1);
    assert_ne!(first, digest(&film, &metadata()));
}

/// A half-float, tiled, PIZ-compressed file with another program's channel names.
fn foreign(compression: Compression, blocks: Blocks) -> Vec<u8> {
    let value = |i: usize| f16::from_f32(i as f32 * 0.25);
    let channel = |name: &str, c: usize| {
        AnyChannel::new(name, FlatSamples::F16((0..70 * 50).map(|i| value(i % 1024 + c)).collect()))
    };
    let channels = ["Combined.B", "Combined.G", "Combined.R"].iter().zip(0..).map(|(n, c)| channel(n, c)).collect();
    let encoding = Encoding { compression, blocks, line_order: LineOrder::Increasing };
    let layer = Layer::new((70, 50), LayerAttributes::named("View"), encoding, AnyChannels::sort(channels));
    let mut bytes = Cursor::new(Vec::new());
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

fn foreign_files() -> Vec<Vec<u8>> {
    vec![
        foreign(Compression::PIZ, Blocks::Tiles(Vec2(32, 16))),
        foreign(Compression::RLE, Blocks::ScanLines),
        foreign(Compression::Uncompressed, Blocks::ScanLines),
        foreign(Compression::PXR24, Blocks::ScanLines),
        foreign(Compression::B44, Blocks::ScanLines),
        foreign(Compression::ZIP16, Blocks::Tiles(Vec2(64, 64))),
    ]
}

#[test]
fn half_floats_tiles_and_other_names_are_read() {
    // B44 (index 4) is lossy.
    for (i, bytes) in foreign_files().iter().enumerate().filter(|(i, _)| *i != 4) {
        let image = decode(bytes).unwrap();
        assert_eq!((image.width, image.height), (70, 50));
        let rgb = image.rgb().unwrap();
        assert_eq!(rgb[0].to_array(), [0.5, 0.25, 0.0], "file {i}");
        assert_eq!(rgb[1000].to_array(), [250.5, 250.25, 250.0], "file {i}");
    }
}

/// A small fixed generator (xorshift64*), so that a failure can be repeated.
fn next(state: &mut u64) -> usize {
    *state ^= *state >> 12;
    *state ^= *state << 25;
    *state ^= *state >> 27;
    (state.wrapping_mul(2_685_821_657_736_338_717) >> 32) as usize
}

#[test]
fn damaged_files_give_errors_not_panics() {
    let ours = encode(&film(70, 50, &[ImageLayer::Normal]), &metadata()).unwrap();
    let mut files = foreign_files();
    files.push(ours);
    let mut state = 0x9e37_79b9_7f4a_7c15;
    for file in &files {
        for cut in 0..file.len().min(700) {
            assert!(decode(&file[..cut]).is_err(), "cut to {cut} bytes");
        }
        for _ in 0..1500 {
            let mut damaged = file.clone();
            for _ in 0..1 + next(&mut state) % 4 {
                // Mostly the header and the offset table, where the sizes are.
                let range = if next(&mut state).is_multiple_of(4) { damaged.len() } else { damaged.len().min(900) };
                let at = next(&mut state) % range;
                damaged[at] = [0, 0xff, 0x7f, 0x80, next(&mut state) as u8][next(&mut state) % 5];
            }
            if let Ok(image) = decode(&damaged) {
                assert!(image.channels.iter().all(|(_, v)| v.len() == image.width * image.height));
            }
        }
    }
}

#[test]
fn a_claimed_size_is_not_believed() {
    let mut bytes = encode(&film(16, 16, &[]), &metadata()).unwrap();
    // Without a chunk count to contradict it, a data window (xMin, yMin, xMax, yMax) of 2²⁸ × 2²⁸ pixels.
    let count = bytes.windows(11).position(|w| w == b"chunkCount\0").unwrap();
    bytes[count] = b'x';
    let name = b"dataWindow\0box2i\0";
    let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    bytes[at + 8..at + 16].copy_from_slice(&[0xff, 0xff, 0xff, 0x0f, 0xff, 0xff, 0xff, 0x0f]);
    let message = decode(&bytes).unwrap_err().to_string();
    assert!(message.contains("limit") && message.contains("268435456"), "{message}");
    assert!(decode(b"").is_err() && decode(b"not an image at all").is_err());
}
