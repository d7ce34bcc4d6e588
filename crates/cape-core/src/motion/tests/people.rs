//! Files of several people, frame by frame or not.

use super::*;

/// VIBE: people by number, in camera coordinates.
fn vibe() -> Py {
    let turned = turned(DQuat::from_rotation_x(PI));
    let of = |frames: usize| {
        Py::dict([
            ("pose", Py::array(&turned.slice(s![..frames, ..]).to_owned())),
            ("betas", Py::array(&Array2::ones((frames, 10)))),
            ("verts", Py::array(&Array3::zeros((frames, 5, 3)))),
            ("joints2d", Py::None),
        ])
    };
    Py::Dict(vec![(Py::Int(1), of(FRAMES)), (Py::Int(7), of(3))])
}

#[test]
fn people_are_chosen_by_name() {
    let files = Files::new();
    let plain = pickle(&vibe(), true);
    let mut encoder = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::default());
    std::io::Write::write_all(&mut encoder, &plain).unwrap();
    let compressed = encoder.finish().unwrap();
    for bytes in [plain, compressed, pickle(&vibe(), false)] {
        let path = files.bytes("vibe_output.pkl", &bytes);
        let message = error(&path);
        assert!(message.contains("2 people: 1 (6 frames), 7 (3 frames)"), "{message}");
        assert!(message.contains("--person"), "{message}");
        let file = person(&path, "1");
        assert_eq!((file.up, file.person.as_deref()), (UpAxis::MinusY, Some("1")));
        expect_poses(&file.motion(None, [0.0; 3]).unwrap().poses, &poses());
        assert_eq!(person(&path, "7").frames(), 3);
        let options = MotionOptions { person: Some("2".into()), ..MotionOptions::default() };
        let message = read_motion(&path, &options).unwrap_err().to_string();
        assert!(message.contains("no person `2`: the file has 1, 7"), "{message}");
        assert_eq!(read_motions(&path, &MotionOptions::default()).unwrap().len(), 2);
    }
    let xz = files.bytes("a.pkl", b"\xfd7zXZ\0\0\0");
    assert!(error(&xz).contains("zlib"), "{}", error(&xz));
}

#[test]
fn estimates_in_the_world_are_preferred_to_those_of_a_camera() {
    let files = Files::new();
    let person = Py::dict([
        ("pose", Py::array(&turned(DQuat::from_rotation_x(PI)))),
        ("trans", Py::array(&Array2::from_elem((FRAMES, 3), 9.0))),
        ("pose_world", Py::array(&poses())),
        ("trans_world", Py::array(&Array2::ones((FRAMES, 3)))),
        ("betas", Py::array(&Array2::zeros((FRAMES, 10)))),
    ]);
    let wham = Py::DefaultDict(vec![(Py::Int(0), person)]);
    let file = read(&files.bytes("wham_output.pkl", &pickle(&wham, true)));
    expect_poses(&file.poses, &poses());
    assert_eq!((file.up, file.translations.unwrap()[(0, 0)]), (UpAxis::Y, 1.0));
}

#[test]
fn frames_of_tracked_people_are_put_together() {
    let files = Files::new();
    let all = matrices();
    let smpl = |frame: usize| {
        let rotations = all.index_axis(Axis(0), frame);
        Py::dict([
            ("global_orient", Py::array(&rotations.slice(s![..1, .., ..]).to_owned())),
            ("body_pose", Py::array(&rotations.slice(s![1.., .., ..]).to_owned())),
            ("betas", Py::array(&Array1::zeros(10))),
        ])
    };
    let names = ["d/8.jpg", "d/9.jpg", "d/10.jpg", "d/11.jpg", "d/12.jpg", "d/13.jpg"];
    // Person 5 is in all frames, person 2 in the first four; the frames are not in order.
    let mut frames: Vec<(Py, Py)> = (0..FRAMES)
        .map(|frame| {
            let (ids, people) = if frame < 4 {
                (vec![Py::Int(2), Py::Int(5)], vec![smpl(0), smpl(frame)])
            } else {
                (vec![Py::Int(5)], vec![smpl(frame)])
            };
            let entry = Py::dict([
                ("time", Py::Int(frame as i64)),
                ("tid", Py::List(ids)),
                ("smpl", Py::List(people)),
            ]);
            (Py::Text(names[frame]), entry)
        })
        .collect();
    frames.swap(0, 2);
    let path = files.bytes("demo.pkl", &pickle(&Py::Dict(frames), true));
    let file = person(&path, "5");
    expect_poses(&file.poses, &poses());
    let file = person(&path, "2");
    assert_eq!(file.frames(), 4);
    assert!(notes(&file).contains("in 4 of 6 frames"), "{}", notes(&file));
}

#[test]
fn rows_of_one_image_are_people() {
    let files = Files::new();
    // ROMP: an archive of one dictionary, rows for people.
    let romp = Py::dict([
        ("smpl_thetas", Py::array(&poses())),
        ("smpl_betas", Py::array(&Array2::zeros((FRAMES, 10)))),
        ("center_confs", Py::array(&Array1::ones(FRAMES))),
    ]);
    let path = files.path("image.npy");
    object_npy(&path, pickle(&romp, false));
    assert!(error(&path).contains("6 people"), "{}", error(&path));
    assert_eq!(person(&path, "3").frames(), 1);
    // Poses and orientation of a person in arrays of their own.
    let one = Py::dict([
        ("smpl_thetas", Py::array(&poses().slice(s![..1, ..]).to_owned())),
        ("body_pose", Py::array(&Array2::zeros((1, 69)))),
        ("global_orient", Py::array(&Array2::zeros((1, 3)))),
    ]);
    object_npy(&path, pickle(&one, false));
    expect_poses(&read(&path).poses, &poses().slice(s![..1, ..]).to_owned());
}

#[test]
fn people_in_the_first_axis_are_told_from_frames() {
    let files = Files::new();
    let two = |table: Array2<f64>| stack(Axis(0), &[table.view(), (2.0 * &table).view()]).unwrap();
    // SLAHMR.
    let path = files.npz("slahmr.npz", |arrays| {
        arrays.add("pose_body", &two(padded(66).slice(s![.., 3..]).to_owned()));
        arrays.add("root_orient", &two(padded(66).slice(s![.., ..3]).to_owned()));
        arrays
            .add("trans", &two(Array2::ones((FRAMES, 3))))
            .add("betas", &Array2::eye(10).slice(s![..2, ..]).to_owned());
    });
    expect_poses(&person(&path, "0").poses, &body());
    let file = person(&path, "1");
    assert_eq!((file.translations.unwrap()[(0, 0)], file.betas[1]), (2.0, 1.0));
    // 3DPW: lists over people.
    let list = |table: Array2<f64>| Py::List(vec![Py::array(&table), Py::array(&(2.0 * &table))]);
    let sequence = Py::dict([
        ("poses", list(poses())),
        ("trans", list(Array2::ones((FRAMES, 3)))),
        ("genders", Py::List(vec![Py::Text("m"), Py::Text("f")])),
    ]);
    let path = files.bytes("downtown.pkl", &pickle(&sequence, false));
    expect_poses(&person(&path, "0").poses, &poses());
    assert_eq!(person(&path, "1").translations.unwrap()[(3, 1)], 2.0);
}

#[test]
fn nested_dictionaries_hand_down_rate_and_gender() {
    let files = Files::new();
    let grab = Py::dict([
        ("gender", Py::Text("male")),
        ("framerate", Py::Float(120.0)),
        ("body", Py::dict([("params", Py::dict([("fullpose", Py::array(&padded(165)))]))])),
    ]);
    let file = read(&files.bytes("grab.pkl", &pickle(&grab, false)));
    assert_eq!((file.frame_rate, file.gender.as_deref()), (Some(120.0), Some("male")));
    // PHC: by the name of the motion.
    let phc = Py::dict([(
        "0-walk",
        Py::dict([
            ("pose_aa", Py::array(&poses())),
            ("beta", Py::array(&Array1::zeros(16))),
            ("fps", Py::Int(30)),
        ]),
    )]);
    let file = read(&files.bytes("phc.pkl", &pickle(&phc, true)));
    assert_eq!((file.frame_rate, file.betas.len(), file.person), (Some(30.0), 16, None));
}
