//! Masks in the forms that programs write.

use std::path::Path;

use cape_core::npy::{NpzWriter, write_npy};
use ndarray::{Array2, Array3};

use super::{Mask, MaskLabel};

const SIDE: usize = 40;

fn disc() -> Mask {
    let covered = (0..SIDE * SIDE).map(|at| inside(at, 13.0));
    Mask::new(SIDE as u32, SIDE as u32, covered.collect()).unwrap()
}

fn inside(at: usize, radius: f64) -> bool {
    let [x, y] = [at % SIDE, at / SIDE].map(|i| i as f64 + 0.5 - 0.5 * SIDE as f64);
    x.hypot(y) < radius
}

struct Place(tempfile::TempDir);

impl Place {
    fn new() -> Self {
        Self(tempfile::tempdir().unwrap())
    }

    fn load(&self, name: &str, labels: &[MaskLabel]) -> Result<Mask, String> {
        Mask::load_labels(self.0.path().join(name), labels).map_err(|error| error.to_string())
    }

    /// Writes a PNG with samples of 8 bits and reads its mask.
    fn png(
        &self,
        colour: png::ColorType,
        data: &[u8],
        labels: &[MaskLabel],
    ) -> Result<Mask, String> {
        self.deep(colour, png::BitDepth::Eight, data, labels)
    }

    fn deep(
        &self,
        colour: png::ColorType,
        depth: png::BitDepth,
        data: &[u8],
        labels: &[MaskLabel],
    ) -> Result<Mask, String> {
        let path = self.0.path().join("mask.png");
        let file = std::fs::File::create(&path).unwrap();
        let mut encoder = png::Encoder::new(file, SIDE as u32, SIDE as u32);
        encoder.set_color(colour);
        encoder.set_depth(depth);
        if colour == png::ColorType::Indexed {
            encoder.set_palette(PALETTE.concat());
        }
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        self.load("mask.png", labels)
    }
}

/// The first colours of the data set of PASCAL.
const PALETTE: [[u8; 3]; 4] = [[0, 0, 0], [128, 0, 0], [0, 128, 0], [192, 128, 128]];

/// A value for each pixel, by the pixel's place.
fn bytes<const N: usize>(of: impl Fn(usize) -> [u8; N]) -> Vec<u8> {
    (0..SIDE * SIDE).flat_map(of).collect()
}

#[test]
fn masks_of_two_values_are_read_whatever_the_values() {
    use png::{BitDepth, ColorType as Colour};
    let (place, mask) = (Place::new(), disc());
    let on = |at: usize| mask.covered()[at];
    for (high, low) in [(1, 0), (255, 0), (15, 0), (9, 4), (255, 200)] {
        let data = bytes(|at| [if on(at) { high } else { low }]);
        assert_eq!(place.png(Colour::Grayscale, &data, &[]).unwrap(), mask, "{high}");
    }
    for high in [1u16, 255, 256, 65535] {
        let data = bytes(|at| if on(at) { high.to_be_bytes() } else { [0; 2] });
        let found = place.deep(Colour::Grayscale, BitDepth::Sixteen, &data, &[]);
        assert_eq!(found.unwrap(), mask, "{high}");
    }
    let bits: Vec<u8> = bytes(|at| [u8::from(on(at))])
        .chunks(8)
        .map(|bits| bits.iter().fold(0, |byte, bit| byte << 1 | bit))
        .collect();
    assert_eq!(place.deep(Colour::Grayscale, BitDepth::One, &bits, &[]).unwrap(), mask);
    // Grey with alpha, all opaque; colours; palettes, whose darker colour may come last.
    let data = bytes(|at| [if on(at) { 255 } else { 0 }, 255]);
    assert_eq!(place.png(Colour::GrayscaleAlpha, &data, &[]).unwrap(), mask);
    let data = bytes(|at| if on(at) { [200, 0, 0] } else { [0, 0, 40] });
    assert_eq!(place.png(Colour::Rgb, &data, &[]).unwrap(), mask);
    let data = bytes(|at| [if on(at) { 3 } else { 0 }]);
    assert_eq!(place.png(Colour::Indexed, &data, &[]).unwrap(), mask);
    let data = bytes(|at| [if on(at) { 1 } else { 3 }]);
    assert_eq!(place.png(Colour::Indexed, &data, &[]).unwrap().area(), SIDE * SIDE - mask.area());
}

#[test]
fn transparency_decides_where_there_is_any() {
    use png::ColorType as Colour;
    let (place, mask) = (Place::new(), disc());
    let on = |at: usize| mask.covered()[at];
    // Dark clothes cut out; a white background behind full transparency; a soft outline.
    let data = bytes(|at| if on(at) { [30, 30, 60, 255] } else { [0; 4] });
    assert_eq!(place.png(Colour::Rgba, &data, &[]).unwrap(), mask);
    let data = bytes(|at| if on(at) { [0, 0, 0, 200] } else { [255, 255, 255, 90] });
    assert_eq!(place.png(Colour::Rgba, &data, &[]).unwrap(), mask);
    let data = bytes(|at| [7, if on(at) { 255 } else { 0 }]);
    assert_eq!(place.png(Colour::GrayscaleAlpha, &data, &[]).unwrap(), mask);
    // Labels are of the colours.
    let data = bytes(|at| if on(at) { [0, 9, 0, 255] } else { [0; 4] });
    let colour = [MaskLabel::Colour([0, 9, 0])];
    assert_eq!(place.png(Colour::Rgba, &data, &colour).unwrap(), mask);
}

#[test]
fn soft_edges_and_compression_noise_are_masks() {
    let (place, mask) = (Place::new(), disc());
    let soft = |at: usize| {
        let [x, y] = [at % SIDE, at / SIDE].map(|i| i as f64 + 0.5 - 0.5 * SIDE as f64);
        (255.0 * (13.5 - x.hypot(y)).clamp(0.0, 1.0)).round() as u8
    };
    let found = place.png(png::ColorType::Grayscale, &bytes(|at| [soft(at)]), &[]).unwrap();
    assert!(found.intersection_over_union(&mask).unwrap() > 0.98);
    for quality in [30, 60, 95] {
        for colour in [jpeg_encoder::ColorType::Luma, jpeg_encoder::ColorType::Rgb] {
            let white = |at: usize| if mask.covered()[at] { 255 } else { 0 };
            let data = match colour {
                jpeg_encoder::ColorType::Luma => bytes(|at| [white(at)]),
                _ => bytes(|at| [white(at); 3]),
            };
            let path = place.0.path().join("mask.jpg");
            let encoder = jpeg_encoder::Encoder::new_file(&path, quality).unwrap();
            encoder.encode(&data, SIDE as u16, SIDE as u16, colour).unwrap();
            let found = place.load("mask.jpg", &[]).unwrap();
            let overlap = found.intersection_over_union(&mask).unwrap();
            assert!(overlap > 0.97, "{quality}: {overlap}");
        }
    }
}

#[test]
fn label_images_need_labels() {
    use png::ColorType as Colour;
    let (place, mask) = (Place::new(), disc());
    // Clothes in a ring around the rest of the person, and something else in a corner.
    let label = |at: usize| match (inside(at, 6.0), inside(at, 13.0), at) {
        (true, ..) => 2,
        (_, true, _) => 3,
        (.., ..200) => 1,
        _ => 0,
    };
    let both = ["2", "3"].map(|text| text.parse().unwrap());
    let data = bytes(|at| [label(at)]);
    for colour in [Colour::Grayscale, Colour::Indexed] {
        let message = place.png(colour, &data, &[]).unwrap_err();
        for part in ["mask.png", "label image with 4 labels", "--labels", "0", "(53.8 %)", "12.5 %"]
        {
            assert!(message.contains(part), "`{part}`: {message}");
        }
        assert_eq!(place.png(colour, &data, &both).unwrap(), mask);
        let message = place.png(colour, &data, &[MaskLabel::Value(15)]).unwrap_err();
        assert!(message.contains("no pixel has the label 15"), "{message}");
    }
    // Pixels without a label are 255.
    let data = bytes(|at| {
        [match label(at) {
            0 if at % 97 == 0 => 255,
            1 => 0,
            value => value,
        }]
    });
    assert!(place.png(Colour::Grayscale, &data, &[]).unwrap_err().contains("4 labels"));
    assert_eq!(place.png(Colour::Grayscale, &data, &both).unwrap(), mask);
    // Colours in place of numbers.
    let data = bytes(|at| PALETTE[usize::from(label(at))]);
    let message = place.png(Colour::Rgb, &data, &[]).unwrap_err();
    assert!(message.contains("#c08080 ("), "{message}");
    let colours = ["#008000", "#C08080"].map(|text| text.parse().unwrap());
    assert_eq!(place.png(Colour::Rgb, &data, &colours).unwrap(), mask);
    assert_eq!(place.png(Colour::Indexed, &bytes(|at| [label(at)]), &colours).unwrap(), mask);
}

#[test]
fn photographs_are_named() {
    let place = Place::new();
    let scene = |at: usize| {
        let wave =
            |k: usize| (127.0 + 120.0 * ((at % SIDE * k + at / SIDE * 3) as f64).sin()) as u8;
        [wave(1), wave(2), wave(3)]
    };
    for message in [
        place.png(png::ColorType::Rgb, &bytes(scene), &[]).unwrap_err(),
        place.png(png::ColorType::Grayscale, &bytes(|at| [scene(at)[0]]), &[]).unwrap_err(),
    ] {
        assert!(message.contains("photograph") && message.contains("--image"), "{message}");
    }
}

#[test]
fn arrays_are_masks() {
    let (place, mask) = (Place::new(), disc());
    let at = |name: &str| place.0.path().join(name);
    let flat = Array2::from_shape_fn((SIDE, SIDE), |(y, x)| mask.covered()[y * SIDE + x]);
    let scaled = |by: f64| flat.mapv(|on| if on { by } else { 0.0 });
    write_npy(at("i64.npy"), &flat.mapv(i64::from)).unwrap();
    write_npy(at("f32.npy"), &flat.mapv(|on| if on { 0.97f32 } else { 0.02 })).unwrap();
    write_npy(at("stack.npy"), &scaled(255.0).insert_axis(ndarray::Axis(0))).unwrap();
    write_npy(at("last.npy"), &scaled(1.0).insert_axis(ndarray::Axis(2))).unwrap();
    // NumPy's booleans.
    let mut header = b"\x93NUMPY\x01\0\x76\0".to_vec();
    header.extend(
        format!(
            "{:<117}\n",
            format!("{{'descr': '|b1', 'fortran_order': False, 'shape': ({SIDE}, {SIDE}), }}")
        )
        .into_bytes(),
    );
    header.extend(mask.covered().iter().map(|&on| u8::from(on)));
    std::fs::write(at("bool.npy"), header).unwrap();
    let mut file = NpzWriter::create(at("named.npz")).unwrap();
    file.add("boxes", &Array2::<f64>::zeros((1, 4))).unwrap();
    file.add("mask", &scaled(1.0)).unwrap();
    file.finish().unwrap();
    for name in ["i64.npy", "f32.npy", "stack.npy", "last.npy", "bool.npy", "named.npz"] {
        assert_eq!(place.load(name, &[]).unwrap(), mask, "{name}");
    }
    let refused = |name: &str, parts: &[&str]| {
        let message = place.load(name, &[]).unwrap_err();
        assert!(parts.iter().all(|part| message.contains(part)), "{message}");
    };
    write_npy(at("three.npy"), &Array3::<f64>::zeros((3, 4, 5))).unwrap();
    refused("three.npy", &["[3, 4, 5]", "masks of 3?"]);
    write_npy(at("negative.npy"), &scaled(-1.0)).unwrap();
    refused("negative.npy", &["value -1"]);
    let mut file = NpzWriter::create(at("none.npz")).unwrap();
    file.add("boxes", &Array2::<f64>::zeros((1, 4))).unwrap();
    file.add("scores", &Array2::<f64>::zeros((1, 1))).unwrap();
    file.finish().unwrap();
    refused("none.npz", &["boxes, scores", "`mask`"]);
    assert!(Mask::load(Path::new("nowhere.npy")).unwrap_err().to_string().contains("nowhere"));
}
