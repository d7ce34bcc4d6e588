//! Masks, photographs and outlines as programs write them.

use std::{fs, fs::File};

use cape::{core::npy::write_npy, render::Image};
use ndarray::Array2;
use serde_json::{Value, json};

use crate::{
    fitting::person,
    support::{Packed, Ran, trained},
};

/// A person of the benchmark.
struct Scene {
    data: Packed,
    run: String,
    mask: Image,
    /// x, y and confidence of each keypoint.
    points: Vec<[f64; 3]>,
}

impl Scene {
    fn new() -> Self {
        let (data, run) = (Packed::new(), trained().at("run").display().to_string());
        person(&data, &run);
        let mask = Image::load(data.at("seen/best/mask.png")).unwrap();
        let text = fs::read(data.at("seen/best/keypoints.json")).unwrap();
        let json: Value = serde_json::from_slice(&text).unwrap();
        let numbers = json["people"][0]["pose_keypoints_2d"].as_array().unwrap();
        let numbers: Vec<f64> = numbers.iter().map(|x| x.as_f64().unwrap()).collect();
        let points = numbers.as_chunks::<3>().0.to_vec();
        Self { data, run, mask, points }
    }

    fn on(&self, at: usize) -> bool {
        self.mask.pixels()[at][0] > 127
    }

    /// First pixel of the row that `share` of the mask is above.
    fn row(&self, share: f64) -> usize {
        let covered: Vec<usize> = (0..self.mask.pixels().len()).filter(|&at| self.on(at)).collect();
        let width = self.mask.width() as usize;
        covered[(share * covered.len() as f64) as usize] / width * width
    }

    fn size(&self) -> [u32; 2] {
        [self.mask.width(), self.mask.height()]
    }

    /// Writes a PNG of a value for each pixel.
    fn png<const N: usize>(
        &self,
        name: &str,
        format: (png::ColorType, png::BitDepth),
        pixel: impl Fn(usize) -> [u8; N],
    ) {
        let [width, height] = self.size();
        let file = File::create(self.data.at(name)).unwrap();
        let mut encoder = png::Encoder::new(file, width, height);
        encoder.set_color(format.0);
        encoder.set_depth(format.1);
        if format.0 == png::ColorType::Indexed {
            encoder.set_palette(&[0, 0, 0, 128, 0, 0, 0, 128, 0, 192, 128, 128][..]);
        }
        let data: Vec<u8> = (0..(width * height) as usize).flat_map(pixel).collect();
        encoder.write_header().unwrap().write_image_data(&data).unwrap();
    }

    /// Writes a JPEG of RGB pixels, with EXIF's orientation.
    fn jpeg(&self, name: &str, [width, height]: [u32; 2], orientation: u8, data: &[u8]) {
        let mut encoder = jpeg_encoder::Encoder::new_file(self.data.at(name), 85).unwrap();
        let mut exif = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0".to_vec();
        exif.extend([orientation, 0, 0, 0, 0, 0, 0, 0]);
        encoder.add_app_segment(1, &exif).unwrap();
        encoder.encode(data, width as u16, height as u16, jpeg_encoder::ColorType::Rgb).unwrap();
    }

    fn keypoints(&self, name: &str, change: impl Fn([f64; 3]) -> [f64; 3]) {
        let numbers: Vec<f64> = self.points.iter().flat_map(|&point| change(point)).collect();
        let json = json!({ "people": [{ "pose_keypoints_2d": numbers }] });
        fs::write(self.data.at(name), json.to_string()).unwrap();
    }

    /// Fits with the options `rest` and returns what is said.
    fn try_fit(&self, keypoints: &str, rest: &str) -> Ran {
        let _ = fs::remove_dir_all(self.data.at("fit"));
        self.data.run(&format!(
            "fit image {} @/{keypoints} {rest} --outfit longlong --config @/few.toml --json --out @/fit",
            self.run
        ))
    }

    /// The clothed fit.
    fn fit(&self, keypoints: &str, rest: &str) -> Value {
        self.try_fit(keypoints, rest).json()["clothed"].take()
    }
}

const POINTS: &str = "seen/best/keypoints.json";
const EIGHT: png::BitDepth = png::BitDepth::Eight;

/// Run lengths of COCO, down the columns.
fn runs(scene: &Scene) -> Value {
    let [width, height] = scene.size().map(|side| side as usize);
    let (mut counts, mut now) = (vec![0], false);
    for at in (0..width).flat_map(|x| (0..height).map(move |y| y * width + x)) {
        if scene.on(at) != now {
            now = !now;
            counts.push(0);
        }
        *counts.last_mut().unwrap() += 1;
    }
    json!({ "size": [height, width], "counts": counts })
}

/// Rectangles of one pixel's height, which together are the mask.
fn polygons(scene: &Scene) -> Value {
    let [width, height] = scene.size().map(|side| side as usize);
    let mut all = Vec::new();
    for y in 0..height {
        let mut x = 0;
        while x < width {
            let start = x;
            while x < width && scene.on(y * width + x) {
                x += 1;
            }
            if x > start {
                all.push(json!([start, y, x, y, x, y + 1, start, y + 1]));
            }
            x += 1;
        }
    }
    json!(all)
}

#[test]
fn every_form_of_a_mask_gives_the_same_fit() {
    use png::ColorType as Colour;
    let scene = Scene::new();
    let on = |at: usize| scene.on(at);
    let reference = scene.fit(POINTS, "--mask @/seen/best/mask.png");
    let middle = scene.row(0.5);

    scene.png("ones.png", (Colour::Grayscale, EIGHT), |at| [u8::from(on(at))]);
    scene.png("deep.png", (Colour::Grayscale, png::BitDepth::Sixteen), |at| {
        [0, 255 * u8::from(on(at))]
    });
    scene.png("palette.png", (Colour::Indexed, EIGHT), |at| [3 * u8::from(on(at))]);
    scene.png("alpha.png", (Colour::GrayscaleAlpha, EIGHT), |at| [255 * u8::from(on(at)), 255]);
    // The person cut out of a photograph, in dark trousers.
    scene.png("cut.png", (Colour::Rgba, EIGHT), |at| match (on(at), at > middle) {
        (false, _) => [0; 4],
        (true, false) => [190, 160, 140, 255],
        (true, true) => [30, 30, 60, 255],
    });
    let [width, height] = scene.size().map(|side| side as usize);
    let array = Array2::from_shape_fn((height, width), |(y, x)| i64::from(on(y * width + x)));
    write_npy(scene.data.at("ones.npy"), &array).unwrap();
    for name in ["ones.png", "deep.png", "palette.png", "alpha.png", "cut.png", "ones.npy"] {
        assert_eq!(scene.fit(POINTS, &format!("--mask @/{name}")), reference, "{name}");
    }

    // A label image: shirt and trousers of the person, and a chair.
    let label = |at: usize| match (on(at), at > middle) {
        (true, false) => 9,
        (true, true) => 12,
        _ if at % 128 < 7 => 3,
        _ => 0,
    };
    scene.png("labels.png", (Colour::Grayscale, EIGHT), |at| [label(at)]);
    assert_eq!(scene.fit(POINTS, "--mask @/labels.png --labels 9,12"), reference);
    let ran = scene.try_fit(POINTS, "--mask @/labels.png");
    ran.failed_saying(&["labels.png", "label image with 4 labels", "--labels", "12 (", "%"]);
    scene
        .try_fit(POINTS, "--mask @/labels.png --labels 15")
        .failed_saying(&["labels.png", "no pixel has the label 15"]);
    scene.try_fit(POINTS, "--mask @/labels.png --labels person").misused(&["--labels", "number"]);

    // Outlines of annotations, with the keypoints or apart.
    let numbers: Vec<f64> = scene.points.iter().flatten().copied().collect();
    let annotation = |segmentation: Value, image: u64| json!({ "image_id": image, "keypoints": numbers, "segmentation": segmentation });
    let images = json!([
        { "id": 7, "file_name": "street.jpg", "width": width, "height": height },
        { "id": 8, "file_name": "beach.jpg", "width": 99, "height": 99 },
    ]);
    let write = |name: &str, annotations: Vec<Value>| {
        let file = json!({ "images": images, "annotations": annotations });
        fs::write(scene.data.at(name), file.to_string()).unwrap();
    };
    let whole = json!([[0, 0, 2, 0, 2, 2, 0, 2]]);
    write("coco.json", vec![annotation(polygons(&scene), 7), annotation(whole.clone(), 8)]);
    write(
        "runs.json",
        vec![
            json!({ "image_id": 7, "segmentation": whole }),
            json!({ "image_id": 7, "segmentation": runs(&scene), "category_id": 1 }),
        ],
    );
    fs::write(scene.data.at("one.json"), runs(&scene).to_string()).unwrap();
    let id = "--image-id street.jpg";
    assert_eq!(scene.fit("coco.json", &format!("--mask @/coco.json {id}")), reference);
    assert_eq!(scene.fit(POINTS, &format!("--mask @/runs.json {id}")), reference);
    assert_eq!(scene.fit(POINTS, "--mask @/one.json"), reference);
    write("away.json", vec![json!({ "image_id": 7, "segmentation": [[0, 0, 2, 0, 2, 2]] })]);
    scene
        .try_fit(POINTS, &format!("--mask @/away.json {id}"))
        .failed_saying(&["away.json", "none of 1 outlines"]);
    scene
        .try_fit(POINTS, &format!("--mask @/{POINTS}"))
        .failed_saying(&["keypoints.json", "no `segmentation`"]);
}

/// Rows F6, F7, U10: what is no mask of the person says what it is, before anything is fitted.
#[test]
fn what_is_no_mask_says_so() {
    use png::ColorType as Colour;
    let scene = Scene::new();
    let [width, height] = scene.size();
    let wave = |at: usize, k: usize| (120.0 + 110.0 * ((at * k) as f64 * 0.37).sin()) as u8;
    let photo: Vec<u8> =
        (0..(width * height) as usize).flat_map(|at| [1, 2, 3].map(|k| wave(at, k))).collect();
    scene.jpeg("photo.jpg", [width, height], 1, &photo);
    scene.png("white.png", (Colour::Grayscale, EIGHT), |_| [255]);
    scene.png("black.png", (Colour::Grayscale, EIGHT), |_| [0]);
    scene.png("inverse.png", (Colour::Grayscale, EIGHT), |at| [255 * u8::from(!scene.on(at))]);
    scene.png("clear.png", (Colour::Rgba, EIGHT), |_| [9, 9, 9, 0]);
    fs::write(scene.data.at("page.png"), "<!DOCTYPE html><p>Sign in").unwrap();
    fs::write(scene.data.at("phone.jpg"), b"\0\0\0\x18ftypheic\0\0").unwrap();
    for (name, parts) in [
        ("photo.jpg", ["photograph", "--image"]),
        ("white.png", ["covers the whole image", "white"]),
        ("black.png", ["mask is empty", "black"]),
        ("clear.png", ["mask is empty", "silhouette"]),
        ("inverse.png", ["joints are on the mask", "inverted"]),
        ("page.png", ["web page", "page.png"]),
        ("phone.jpg", ["HEIC", "PNG or JPEG"]),
    ] {
        let ran = scene.try_fit(POINTS, &format!("--mask @/{name}"));
        ran.failed_saying(&[&parts[..], &[name]].concat());
    }

    // Keypoints of an image of twice the size, and normalised ones.
    scene.keypoints("twice.json", |[x, y, c]| [2.0 * x, 2.0 * y, c]);
    scene
        .try_fit("twice.json", "--mask @/seen/best/mask.png")
        .failed_saying(&["beyond the 128×128 pixels of the mask", "another size"]);
    scene.keypoints("unit.json", |[x, y, c]| [x / 128.0, y / 128.0, c]);
    let ran = scene.try_fit("unit.json", "--mask @/seen/best/mask.png");
    assert!(ran.err.contains("scaled to 128×128"), "{}", ran.err);
    let [scaled, given] = [ran.json(), scene.try_fit(POINTS, "--mask @/seen/best/mask.png").json()]
        .map(|report| report["clothed"]["joint_error"].as_f64().unwrap());
    assert!((scaled - given).abs() < 1e-3 * given.max(1.0), "{scaled} {given}");
    for size in ["128", "0x9", "axb"] {
        let rest = format!("--mask @/seen/best/mask.png --image-size {size}");
        scene.try_fit(POINTS, &rest).misused(&["--image-size", "640x480"]);
    }
    scene
        .try_fit(POINTS, "--mask @/seen/best/mask.png --image-size 640x480")
        .failed_saying(&["--mask: 128×128", "--image-size has 640×480"]);
}

#[test]
fn photographs_are_turned_upright() {
    let scene = Scene::new();
    let [width, height] = scene.size();
    // Wider than it is high, when seen: a margin on the right; stored turned by 90°.
    let wide = width + 32;
    let grey = |x: u32, y: u32| if x < width { 60 + (y / 2) as u8 } else { 250 };
    let stored: Vec<u8> = (0..wide)
        .flat_map(|row| {
            (0..height).flat_map(move |column| {
                // Orientation 6: seen (x, y) is stored at column y, row wide − 1 − x.
                [grey(wide - 1 - row, column); 3]
            })
        })
        .collect();
    scene.jpeg("camera.jpg", [height, wide], 6, &stored);
    let mut mask = Image::new(wide, height, [0, 0, 0, 255]).unwrap();
    mask.draw(&scene.mask, 0, 0);
    mask.save(scene.data.at("wide.png")).unwrap();
    let ran = scene.try_fit(POINTS, "--mask @/wide.png --image @/camera.jpg");
    assert!(ran.err.contains("upright"), "{}", ran.err);
    ran.succeeded();
    let overlay = Image::load(scene.data.at("fit/overlay.png")).unwrap();
    assert!(overlay.width() > 3 * wide && overlay.height() > height);

    scene.jpeg("flat.jpg", [height, wide], 1, &stored);
    scene.try_fit(POINTS, "--mask @/wide.png --image @/flat.jpg").failed_saying(&[
        "--mask: 160×128",
        "--image has 128×160",
        "turned by 90°",
    ]);
}

#[test]
fn people_are_fitted_without_a_mask() {
    let scene = Scene::new();
    scene.try_fit(POINTS, "").failed_saying(&["size of the image is unknown", "--image-size"]);
    let report = scene.try_fit(POINTS, "--image-size 128x128").json();
    assert_eq!(report["clothed"]["intersection_over_union"], Value::Null);
    assert_eq!(report["clothed"]["terms"]["silhouette"], json!({ "rendered": 0.0, "image": 0.0 }));
    assert!(report["notes"][0].as_str().unwrap().contains("silhouette term is left out"));
    assert!(scene.data.at("fit/overlay.png").exists());
    // The size is the photograph's.
    scene.png("photo.png", (png::ColorType::Rgb, EIGHT), |at| [(at % 251) as u8; 3]);
    let photo = scene.fit(POINTS, "--image @/photo.png");
    assert_eq!(photo, report["clothed"]);
    // Or the file's; nothing tells the outfits apart.
    let numbers: Vec<f64> = scene.points.iter().flatten().copied().collect();
    let file = json!({
        "images": [{ "id": 7, "file_name": "street.jpg", "width": 128, "height": 128 }],
        "annotations": [{ "image_id": 7, "keypoints": numbers }],
    });
    fs::write(scene.data.at("coco.json"), file.to_string()).unwrap();
    let text = scene
        .data
        .run(&format!("fit image {} @/coco.json --config @/few.toml --out @/any", scene.run))
        .succeeded();
    for part in ["no silhouette", "hardly observed", "nothing tells the outfits apart"] {
        assert!(text.contains(part), "{text}");
    }
    for rest in ["--compare-outfits", "--labels 3", "--occluders @/photo.png"] {
        scene.try_fit(POINTS, &format!("--image @/photo.png {rest}")).misused(&["--mask"]);
    }
}

#[test]
fn occluders_count_neither_way() {
    let scene = Scene::new();
    // A table in front of the legs: what is under it does not matter.
    let first = scene.row(0.75);
    let table = |at: usize| at >= first;
    let grey = (png::ColorType::Grayscale, EIGHT);
    scene.png("table.png", grey, |at| [u8::from(table(at))]);
    scene.png("cut.png", grey, |at| [u8::from(scene.on(at) && !table(at))]);
    scene.png("full.png", grey, |at| [u8::from(scene.on(at) || table(at))]);
    scene.png("none.png", grey, |_| [0]);
    let fit = |rest: &str| scene.fit(POINTS, rest);
    let cut = fit("--mask @/cut.png --occluders @/table.png");
    assert_eq!(cut, fit("--mask @/full.png --occluders @/table.png"));
    assert_eq!(cut, fit("--mask @/seen/best/mask.png --occluders @/table.png"));
    assert_ne!(cut["code"], fit("--mask @/cut.png")["code"]);
    let plain = fit("--mask @/seen/best/mask.png");
    assert_eq!(plain, fit("--mask @/seen/best/mask.png --occluders @/none.png"));
    scene.png("all.png", grey, |at| [u8::from(at > 0)]);
    scene
        .try_fit(POINTS, "--mask @/seen/best/mask.png --occluders @/all.png")
        .failed_saying(&["hide the whole person"]);
    Image::new(64, 64, [0, 0, 0, 255]).unwrap().save(scene.data.at("small.png")).unwrap();
    scene
        .try_fit(POINTS, "--mask @/seen/best/mask.png --occluders @/small.png")
        .failed_saying(&["--occluders: 64×64", "--mask has 128×128"]);
}
