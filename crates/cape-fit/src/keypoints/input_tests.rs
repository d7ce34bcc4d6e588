//! Keypoints as detectors write them.

use serde_json::{Value, json};

use super::*;

/// A standing person, BODY_25, pixels of an image of 256 × 256.
fn person() -> Vec<[f64; 3]> {
    let places = [
        (128, 40),
        (128, 60),
        (108, 62),
        (100, 95),
        (96, 125),
        (148, 62),
        (156, 95),
        (160, 125),
        (128, 130),
        (118, 130),
        (116, 175),
        (115, 220),
        (138, 130),
        (140, 175),
        (141, 220),
        (124, 36),
        (132, 36),
        (120, 38),
        (136, 38),
        (146, 230),
        (148, 228),
        (140, 226),
        (110, 230),
        (108, 228),
        (114, 226),
    ];
    places.iter().map(|&(x, y)| [f64::from(x), f64::from(y), 0.9]).collect()
}

/// The 17 points of COCO among BODY_25's.
fn coco() -> Vec<[f64; 3]> {
    let order = [0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11];
    order.map(|at| person()[at]).to_vec()
}

fn flat(points: &[[f64; 3]]) -> Value {
    json!(points.as_flattened())
}

fn read_with(text: &str, options: &KeypointOptions) -> Result<People> {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("a.json");
    std::fs::write(&path, text).unwrap();
    read_keypoints_with(&path, options)
}

fn read(json: &Value) -> People {
    read_with(&json.to_string(), &KeypointOptions::default()).unwrap()
}

/// Places of the left wrist and the right ankle, which all layouts have.
fn ends(keypoints: &Keypoints) -> [(f64, f64); 2] {
    [20, 8].map(|joint| {
        let found = keypoints.detections(0.0);
        let at = found.iter().find(|detection| detection.joint == joint).unwrap().at;
        (at.x, at.y)
    })
}

const ENDS: [(f64, f64); 2] = [(160.0, 125.0), (115.0, 220.0)];

#[test]
fn dialects_of_one_person_agree() {
    let c = coco();
    let xy: Vec<[f64; 2]> = c.iter().map(|p| [p[0], p[1]]).collect();
    let scores: Vec<f64> = c.iter().map(|p| p[2]).collect();
    let column = |i: usize| -> Vec<f64> { c.iter().map(|p| p[i]).collect() };
    let one = json!({"keypoints": xy, "keypoint_scores": scores, "bbox": [[0, 0, 255, 255]]});
    let objects: Vec<Value> =
        c.iter().map(|p| json!({"x": p[0], "y": p[1], "score": p[2], "name": "a"})).collect();
    let mut blaze = vec![json!({"x": 0.5, "y": 0.2, "z": 0.0, "visibility": 0.9}); 33];
    for (&(to, joint), p) in KeypointLayout::MediaPipe33.joints().iter().zip(&c[5..]) {
        assert!(joint < 24);
        blaze[to] = json!({"x": p[0] / 256.0, "y": p[1] / 256.0, "z": 0.0, "visibility": 0.9});
    }
    let annotation = json!({"image_id": 7, "keypoints": flat(&c), "num_keypoints": 17});
    let image = json!({"id": 7, "file_name": "a.jpg", "width": 256, "height": 256});
    let files = [
        json!({"version": 1.3, "people": [{"pose_keypoints_2d": flat(&person())}]}),
        json!({"version": 0.1, "people": [{"pose_keypoints": flat(&person())}]}),
        json!({"version": 0.1, "bodies": [{"joints": flat(&person())}]}),
        json!([{"image_id": "1.jpg", "category_id": 1, "keypoints": flat(&c), "score": 2.9}]),
        json!({"1.jpg": {"version": 0.1, "people": [{"pose_keypoints_2d": flat(&person())}]}}),
        json!({"images": [image], "annotations": [annotation]}),
        json!([one]),
        json!({"meta_info": {"dataset_name": "coco"}, "instance_info": [one]}),
        json!({"instance_info": [{"frame_id": 1, "instances": [one]}]}),
        json!([{"frame_id": 0, "instances": [one]}]),
        json!([{"keypoints": c, "bbox": [0, 0, 9, 9, 0.9]}]),
        json!([{"preds": [c], "image_paths": ["a.jpg"]}]),
        json!({"keypoints": [xy], "scores": [scores]}),
        json!([{"score": 0.9, "keypoints": objects}]),
        json!([{"name": "person", "keypoints":
            {"x": column(0), "y": column(1), "visible": column(2)}}]),
        json!({"keypoints": xy.as_flattened()}),
        json!({"landmarks": [blaze]}),
        json!({"pose_landmarks": {"landmark": blaze}}),
        json!({"poseLandmarks": blaze}),
        json!(blaze),
        json!([{"people": [{"pose_keypoints_2d": flat(&person())}], "canvas_width": 256,
            "canvas_height": 256}]),
    ];
    let options = KeypointOptions { size: Some([256, 256]), ..KeypointOptions::default() };
    for file in files {
        let text = file.to_string();
        let people = read_with(&text, &options).unwrap_or_else(|e| panic!("{e}: {text}"));
        let keypoints = people.choose(None).unwrap_or_else(|e| panic!("{e}: {text}"));
        assert_eq!(ends(&keypoints), ENDS, "{text}");
    }
}

#[test]
fn layouts_are_those_of_the_count_or_the_most_plausible() {
    let p = person();
    let mid = |a: usize, b: usize| [0, 1, 2].map(|i| 0.5 * (p[a][i] + p[b][i]));
    let h36m: Vec<[f64; 3]> = [
        mid(9, 12),
        p[9],
        p[10],
        p[11],
        p[12],
        p[13],
        p[14],
        mid(1, 8),
        p[1],
        p[0],
        p[0],
        p[5],
        p[6],
        p[7],
        p[2],
        p[3],
        p[4],
    ]
    .to_vec();
    let b =
        [0, 16, 15, 18, 17, 5, 2, 6, 3, 7, 4, 12, 9, 13, 10, 14, 11, 1, 0, 19, 20, 21, 22, 23, 24];
    let body25b: Vec<[f64; 3]> = b.map(|at| p[at]).to_vec();
    for (points, layout) in
        [(h36m.clone(), KeypointLayout::H36m17), (body25b, KeypointLayout::Body25b)]
    {
        let people = read(&json!([{"image_id": 1, "keypoints": flat(&points)}]));
        assert!(people.notes()[0].contains(&layout.to_string()), "{:?}", people.notes());
        let keypoints = people.choose(None).unwrap();
        assert_eq!((keypoints.layout(), ends(&keypoints)), (layout, ENDS));
    }
    // Named layouts are not questioned.
    let named = KeypointOptions { layout: Some(KeypointLayout::Coco17), ..Default::default() };
    let text = json!([{"keypoints": flat(&h36m)}]).to_string();
    let people = read_with(&text, &named).unwrap();
    assert!(people.notes().is_empty());
    assert_eq!(people.choose(None).unwrap().layout(), KeypointLayout::Coco17);
    // Whole bodies begin with COCO's points.
    for count in [26, 133, 136] {
        let mut points = coco();
        points.resize(count, [0.0; 3]);
        let people = read(&json!([{"image_id": "1.jpg", "keypoints": flat(&points)}]));
        assert_eq!(ends(&people.choose(None).unwrap()), ENDS);
    }
}

#[test]
fn what_is_not_seen_is_no_error() {
    let p = person();
    let unseen = |point: Value| {
        let mut numbers = flat(&p);
        let list = numbers.as_array_mut().unwrap();
        list.splice(12..15, point.as_array().unwrap().clone());
        json!({"people": [{"pose_keypoints_2d": numbers}]}).to_string()
    };
    let files = [
        unseen(json!([0, 0, -0.01])),
        unseen(json!([0, 0, 0.8])),
        unseen(json!([-1, -1, 0.8])),
        unseen(json!([null, null, null])),
        unseen(json!(["NaN", "NaN", "NaN"])).replace("\"NaN\"", "NaN"),
        format!("\u{feff}{}", unseen(json!([50, 50, 0]))),
    ];
    for text in files {
        let people = read_with(&text, &KeypointOptions::default()).unwrap();
        let keypoints = people.choose(None).unwrap();
        assert_eq!(keypoints.points()[4], Keypoint::UNSEEN, "{text}");
        assert_eq!(keypoints.detections(0.0).len(), 13);
    }
    let sure = read(&json!({"people": [{"pose_keypoints_2d": flat(&[[5.0, 6.0, 1.40701]; 25])}]}));
    assert_eq!(sure.choose(None).unwrap().points()[0].confidence, 1.0);
}

#[test]
fn people_are_independent_and_the_one_on_the_mask_is_taken() {
    let p = person();
    let moved: Vec<[f64; 3]> = p.iter().map(|[x, y, c]| [x + 70.0, *y, *c]).collect();
    let crowd = |people: &[Value]| {
        let entry = |points: &Value| json!({"pose_keypoints_2d": points});
        read(&json!({"people": people.iter().map(entry).collect::<Vec<_>>()}))
    };
    let covered = (0..256 * 256).map(|at| (85..170).contains(&(at % 256)) && at / 256 > 20);
    let mask = crate::Mask::new(256, 256, covered.collect()).unwrap();
    let people = crowd(&[json!([]), flat(&p)]);
    assert_eq!(people.index(None, None).unwrap(), 1);
    let message = people.person(0).unwrap_err().to_string();
    assert!(message.contains("people[0].pose_keypoints_2d: nobody"), "{message}");
    let people = crowd(&[json!([1, 2]), flat(&moved), flat(&p)]);
    assert_eq!((people.len(), people.index(None, Some(&mask)).unwrap()), (3, 2));
    let message = people.index(None, None).unwrap_err().to_string();
    assert!(message.contains("2 people") && message.contains("person 2: 14 joints"), "{message}");
    assert!(people.person(0).unwrap_err().to_string().contains("people[0]"));
    let alike = crowd(&[flat(&p), flat(&p)]).index(None, Some(&mask)).unwrap_err().to_string();
    assert!(alike.contains("0 and 1"), "{alike}");
    let nobody = crowd(&[]).index(None, None).unwrap_err().to_string();
    assert!(nobody.contains("nobody"), "{nobody}");
}

#[test]
fn images_of_a_file_are_told_by_name_or_number() {
    let moved: Vec<[f64; 3]> = coco().iter().map(|[x, y, c]| [x + 1.0, *y, *c]).collect();
    let results = json!([
        {"image_id": 139, "keypoints": flat(&moved)}, {"image_id": 140, "keypoints": flat(&coco())},
    ])
    .to_string();
    let image = |name: &str| KeypointOptions { image: Some(name.into()), ..Default::default() };
    let beside = KeypointOptions { beside: vec!["000000000140.jpg".into()], ..Default::default() };
    for options in [image("140"), image("000000000140.png"), beside] {
        let people = read_with(&results, &options).unwrap();
        assert_eq!(ends(&people.choose(None).unwrap()), ENDS);
    }
    let open = read_with(&results, &KeypointOptions::default()).unwrap_err().to_string();
    assert!(open.contains("--image-id"), "{open}");
    let none = read_with(&results, &image("5")).unwrap_err().to_string();
    assert!(none.contains("139, 140"), "{none}");
}

#[test]
fn normalised_coordinates_are_scaled_or_refused() {
    let scaled = |centred: bool| {
        let place = |x: f64| if centred { x / 128.0 - 1.0 } else { x / 256.0 };
        let p: Vec<[f64; 3]> = person().iter().map(|&[x, y, c]| [place(x), place(y), c]).collect();
        json!({"people": [{"pose_keypoints_2d": flat(&p)}]}).to_string()
    };
    let size = KeypointOptions { size: Some([256, 256]), ..Default::default() };
    for (text, range) in [(scaled(false), "0 to 1"), (scaled(true), "−1 to 1")] {
        let people = read_with(&text, &size).unwrap();
        assert!(people.notes()[0].contains(range), "{:?}", people.notes());
        assert_eq!(ends(&people.choose(None).unwrap()), ENDS);
        let refused = read_with(&text, &KeypointOptions::default()).unwrap().choose(None);
        assert!(refused.unwrap_err().to_string().contains("expected pixels"));
    }
}
