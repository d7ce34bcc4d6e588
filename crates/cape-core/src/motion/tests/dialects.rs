//! Files that are like others and mean something else.

use super::*;

/// Posed vertices of the synthetic body in every tenth row, and its pelvis.
fn posed(motion: &BodyMotion, frame: usize) -> Vec<DVec3> {
    let body = cape_synth::synthetic_body();
    let shape = body.rest_shape(&[0.0; 10]).unwrap();
    let pose = motion.poses.row(frame).to_vec();
    let vertices =
        body.pose_shape(&shape, &pose, motion.translation(frame), None).unwrap().vertices;
    vertices.rows().into_iter().step_by(500).map(|p| DVec3::new(p[0], p[1], p[2])).collect()
}

fn table(frames: usize, row: &[f64]) -> Array2<f64> {
    Array2::from_shape_fn((frames, row.len()), |(_, k)| row[k])
}

#[test]
fn easymocap_turns_the_body_about_the_origin() {
    let files = Files::new();
    let body = cape_synth::synthetic_body();
    let joints = body.rest_joints(&body.rest_shape(&[0.0; 10]).unwrap()).unwrap();
    let pelvis = [0, 1, 2].map(|axis| joints[(0, axis)]);
    let mut unturned = poses();
    unturned.slice_mut(s![.., ..3]).fill(0.0);
    // Its world has z up: a quarter about x, then the way that the body faces.
    let turn = DQuat::from_rotation_x(PI / 2.0) * DQuat::from_rotation_y(0.7);
    let (turned, moved) = (turn.to_scaled_axis(), DVec3::new(1.0, 2.0, 1.3));
    let still = BodyMotion::new(30.0, unturned.clone(), Array2::zeros((FRAMES, 3))).unwrap();
    for (first, last) in [(0, 72), (3, 72), (0, 66)] {
        // SMPL, SMPL without the zeros of its root, and SMPL-X with components of the hands.
        let mut rows = unturned.slice(s![.., first..last]).to_owned();
        if last == 66 {
            let hands = Array2::zeros((FRAMES, 21));
            rows = ndarray::concatenate(Axis(1), &[rows.view(), hands.view()]).unwrap();
        }
        let path = files.npz("params.npz", |arrays| {
            arrays.add("poses", &rows).add("Rh", &table(FRAMES, &turned.to_array()));
            arrays.add("Th", &table(FRAMES, &moved.to_array()));
            arrays.add("shapes", &Array2::zeros((1, 10)));
        });
        let file = read(&path);
        assert_eq!((file.pivot, file.up), (Pivot::Origin, UpAxis::Z));
        let motion = file.motion(None, pelvis).unwrap();
        // v = R x + t, and z up becomes y up. Hands of SMPL do not move in this motion.
        for (x, v) in posed(&still, 2).into_iter().zip(posed(&motion, 2)) {
            let expected = UpAxis::Z.to_y() * (turn * x + moved);
            assert!(expected.abs_diff_eq(v, 1e-9), "{first}..{last}: {expected} {v}");
        }
    }
    // One file a frame; newer ones hold people in `annots`. The frames sort by number.
    std::fs::create_dir(files.path("smpl")).unwrap();
    for frame in 0..12 {
        let list = |row: &[f64]| serde_json::json!([row]);
        let pose = unturned.row(frame % FRAMES).to_vec();
        let person = |id: usize, x: f64| {
            serde_json::json!({"id": id, "Rh": list(&turned.to_array()), "Th": list(&[x, 0.0, 1.0]),
                "poses": list(&pose), "shapes": list(&[0.5; 10])})
        };
        let people = if frame < 4 {
            vec![person(3, -5.0), person(7, frame as f64)]
        } else {
            vec![person(7, frame as f64)]
        };
        let text = serde_json::json!({ "annots": people }).to_string();
        files.bytes(&format!("smpl/{frame}.json"), text.as_bytes());
    }
    let directory = files.path("smpl");
    let message = error(&directory);
    assert!(message.contains("3 (4 frames), 7 (12 frames)"), "{message}");
    let file = person(&directory, "7");
    let way: Vec<f64> = file.translations.as_ref().unwrap().column(0).to_vec();
    assert_eq!(way, (0..12).map(f64::from).collect::<Vec<_>>());
    assert!(notes(&person(&directory, "3")).contains("in 4 of 12 frames"));
    // Rh beside an orientation in the pose has no known meaning.
    let path = files.npz("both.npz", |arrays| {
        arrays.add("poses", &poses()).add("Rh", &table(FRAMES, &turned.to_array()));
    });
    assert!(error(&path).contains("an orientation of its own"), "{}", error(&path));
}

#[test]
fn a_directory_holds_a_pose_in_each_file() {
    let files = Files::new();
    std::fs::create_dir(files.path("frames")).unwrap();
    let directory = files.path("frames");
    assert!(error(&directory).contains("without files of poses"), "{}", error(&directory));
    for frame in 0..FRAMES {
        let path = directory.join(format!("image_{frame}.npy"));
        write_npy(&path, &poses().slice(s![frame..=frame, ..]).to_owned()).unwrap();
    }
    std::fs::write(directory.join("readme.txt"), "no poses").unwrap();
    expect_poses(&read(&directory).poses, &poses());
    write_npy(directory.join("walk.npy"), &poses()).unwrap();
    let message = error(&directory);
    assert!(message.contains("walk.npy") && message.contains("6 poses, expected one"), "{message}");
}

#[test]
fn positions_in_a_persons_proportions_are_named() {
    let files = Files::new();
    let path = files.path("joints.npy");
    let body = cape_synth::synthetic_body();
    let rest = body.rest_joints(&body.rest_shape(&[1.0, -1.0]).unwrap()).unwrap();
    for (frames, joints, noise, unit) in
        [(3, 22, 0.0, 1.0), (1, 24, 0.0, 100.0), (6, 52, 0.01, 1.0), (6, 55, 0.01, 1.0)]
    {
        // Hands and face lie about the wrists and the head.
        let rows = Array3::from_shape_fn((frames, joints, 3), |(frame, joint, axis)| {
            let wave = noise * ((7 * frame + 13 * joint + 5 * axis) as f64).sin();
            let at = rest[(if joint < 24 { joint } else { 15 + joint % 7 }, axis)];
            unit * (at + wave + 0.1 * frame as f64)
        });
        write_npy(&path, &rows).unwrap();
        let message = error(&path);
        assert!(message.contains("positions of joints"), "{joints}: {message}");
    }
    // Rotations of all joints by like angles are none.
    let mut twisted = Array2::from_elem((4, 72), 0.1);
    twisted.row_mut(2).fill(0.15);
    write_npy(&path, &twisted).unwrap();
    expect_poses(&read(&path).poses, &twisted);
    for (shape, expected) in [
        (&[6, 17, 3][..], "positions of joints"),
        (&[6, 24, 4], "quaternions"),
        (&[6, 263], "features of HumanML3D"),
        (&[72, 6], "transpose"),
    ] {
        write_npy(&path, &ArrayD::<f64>::zeros(shape)).unwrap();
        assert!(error(&path).contains(expected), "{}", error(&path));
    }
    // EDGE has positions beside the rotations.
    let rows = Array3::from_shape_fn((FRAMES, 24, 3), |(_, joint, axis)| rest[(joint, axis)]);
    let dance = Py::dict([
        ("full_pose", Py::array(&rows)),
        ("smpl_poses", Py::array(&poses())),
        ("smpl_trans", Py::array(&Array2::ones((FRAMES, 3)))),
    ]);
    expect_poses(&read(&files.bytes("dance.pkl", &pickle(&dance, false))).poses, &poses());
}

#[test]
fn degrees_are_told_from_radians() {
    let files = Files::new();
    let path = files.path("a.npy");
    write_npy(&path, &poses().mapv(f64::to_degrees)).unwrap();
    let message = error(&path);
    assert!(message.contains("are degrees") && message.contains("numpy.radians"), "{message}");
    // A root that turned many times, and a joint that an optimiser wound up, are radians.
    let mut wound = poses();
    wound[(FRAMES - 1, 1)] = 40.0;
    wound[(2, 61)] = 13.0;
    write_npy(&path, &wound).unwrap();
    expect_poses(&read(&path).poses, &wound);
}

#[test]
fn ways_of_scaled_bodies_are_divided_by_the_scale() {
    let files = Files::new();
    let scales = Array1::from_elem(FRAMES, 2.0);
    for (name, scale) in
        [("transl", scales.clone()), ("translation", scales.slice(s![..1]).to_owned())]
    {
        let path = files.npz("scaled.npz", |arrays| {
            arrays.add("global_orient", &poses().slice(s![.., ..3]).to_owned());
            arrays.add("body_pose", &poses().slice(s![.., 3..]).to_owned());
            arrays.add(name, &Array2::from_elem((FRAMES, 3), 3.0)).add("scale", &scale);
        });
        let file = read(&path);
        assert_eq!(file.translations.as_ref().unwrap()[(1, 2)], 1.5);
        assert!(notes(&file).contains("scaled by 2 in the file (`scale`)"), "{}", notes(&file));
    }
    // With poses of all joints, `scale` is that of an image.
    let path = files.npz("cropped.npz", |arrays| {
        arrays.add("pose", &poses()).add("trans", &Array2::ones((FRAMES, 3))).add("scale", &scales);
    });
    assert_eq!(read(&path).translations.unwrap()[(1, 2)], 1.0);
}

#[test]
fn results_in_the_world_are_preferred_to_those_in_the_camera() {
    let files = Files::new();
    let of = |turn: DQuat, way: f64| {
        let turned = turned(turn);
        Py::dict([
            ("global_orient", Py::array(&turned.slice(s![.., ..3]).to_owned())),
            ("body_pose", Py::array(&turned.slice(s![.., 3..66]).to_owned())),
            ("transl", Py::array(&Array2::from_elem((FRAMES, 3), way))),
            ("betas", Py::array(&Array2::zeros((FRAMES, 10)))),
        ])
    };
    for (world, camera) in
        [("smpl_params_global", "smpl_params_incam"), ("smplx_world", "smplx_cam")]
    {
        let both = || {
            Py::dict([
                (camera, of(DQuat::from_rotation_x(PI), 9.0)),
                (world, of(DQuat::IDENTITY, 1.0)),
            ])
        };
        let file = read(&files.bytes("hmr4d_results.pkl", &pickle(&both(), false)));
        assert_eq!((file.up, file.translations.as_ref().unwrap()[(0, 0)]), (UpAxis::Y, 1.0));
        assert!(
            notes(&file).contains(&format!("`{world}` is read, `{camera}`")),
            "{}",
            notes(&file)
        );
        let people =
            Py::dict([("people", Py::Dict(vec![(Py::Int(1), both()), (Py::Int(2), both())]))]);
        let path = files.bytes("results.pkl", &pickle(&people, true));
        assert_eq!(person(&path, "2").translations.unwrap()[(0, 0)], 1.0);
    }
}

#[test]
fn rates_are_found_as_text_and_in_details() {
    let files = Files::new();
    let path = files.npz("text.npz", |arrays| {
        arrays.add("poses", &poses()).text("fps", "60");
    });
    assert_eq!(read(&path).frame_rate, Some(60.0));
    // MoSh's own results.
    let details = Py::dict([("mocap_frame_rate", Py::Float(120.0)), ("cfg", Py::None)]);
    let moshed = Py::dict([
        ("fullpose", Py::array(&padded(165))),
        ("betas", Py::array(&Array1::zeros(400))),
        ("stageii_debug_details", details),
    ]);
    let file = read(&files.bytes("walk_stageii.pkl", &pickle(&moshed, false)));
    assert_eq!((file.frame_rate, file.betas.len()), (Some(120.0), 400));
}

#[test]
fn clips_of_unequal_lengths_and_rows_of_images_are_told() {
    let files = Files::new();
    let short = poses().slice(s![..2, ..]).to_owned();
    let clips = Py::dict([
        ("poses", Py::List(vec![Py::array(&poses()), Py::array(&short)])),
        ("y", Py::List(vec![Py::Int(0), Py::Int(1)])),
    ]);
    let path = files.bytes("actions.pkl", &pickle(&clips, false));
    assert!(error(&path).contains("0 (6 frames), 1 (2 frames)"), "{}", error(&path));
    expect_poses(&person(&path, "1").poses, &short);
    let images = Py::dict([
        ("pose", Py::array(&poses())),
        ("imgname", Py::Text("a.jpg")),
        ("scale", Py::array(&Array1::ones(FRAMES))),
    ]);
    let file = read(&files.bytes("coco.pkl", &pickle(&images, false)));
    assert!(notes(&file).contains("rows belong to images (`imgname`)"), "{}", notes(&file));
}

#[test]
fn formats_of_other_skeletons_are_named() {
    let files = Files::new();
    for (bytes, expected) in [
        (&b"Kaydara FBX Binary  \x00\x1a\x00"[..], "FBX"),
        (b"; FBX 7.3.0 project file\n", "FBX"),
        (b"\x02P\x00\x00\x00\x00\x00\x00", "C3D"),
        (b"PathFileType\t4\t(X/Y/Z)\tx.trc\n", "TRC"),
        (b"\x89HDF\r\n\x1a\n\0\0", "h5py"),
        (b"PXR-USDC\0\0", "USD"),
        (b"#usda 1.0\n", "USD"),
        (b"Vocaloid Motion Data 0002\0", "VMD"),
    ] {
        let path = files.bytes("a.bin", bytes);
        assert!(error(&path).contains(expected), "{}", error(&path));
    }
}
