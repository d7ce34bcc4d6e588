//! Layouts and containers of poses.

use super::*;

#[test]
fn parameters_by_the_names_of_smplx_are_read() {
    let files = Files::new();
    let part = |from: usize, to: usize| poses().slice(s![.., from..to]).to_owned();
    for (width, expected) in [(63, body()), (69, poses())] {
        let path = files.npz("smplx.npz", |arrays| {
            arrays.add("global_orient", &part(0, 3)).add("body_pose", &part(3, 3 + width));
            arrays.add("transl", &Array2::ones((FRAMES, 3))).add("betas", &Array2::ones((1, 10)));
            arrays.add("left_hand_pose", &Array2::zeros((FRAMES, 45)));
            arrays.add("right_hand_pose", &Array2::zeros((FRAMES, 45)));
            arrays.add("expression", &Array2::zeros((FRAMES, 10)));
        });
        let file = read(&path);
        expect_poses(&file.poses, &expected);
        assert_eq!(
            (file.betas.clone(), file.translations.clone().unwrap()[(2, 1)]),
            (vec![1.0; 10], 1.0)
        );
        assert!(notes(&file).contains("30 hand joints, 10 expression coefficients"));
        assert!(notes(&file).contains("no frame rate"));
    }
    let path = files.npz("slow.npz", |arrays| {
        arrays.add("global_orient", &part(0, 3).slice(s![..2, ..]).to_owned());
        arrays.add("body_pose", &part(3, 66));
    });
    assert!(error(&path).contains("`global_orient`: shape [2, 3]"), "{}", error(&path));
}

#[test]
fn poses_by_joint_and_as_matrices_are_read() {
    let files = Files::new();
    let by_joint = poses().into_shape_with_order((FRAMES, 24, 3)).unwrap();
    let path = files.path("a.npy");
    write_npy(&path, &by_joint).unwrap();
    expect_poses(&read(&path).poses, &poses());
    write_npy(&path, &by_joint.index_axis(Axis(0), 2).to_owned()).unwrap();
    expect_poses(&read(&path).poses, &poses().slice(s![2..3, ..]).to_owned());
    write_npy(&path, &matrices()).unwrap();
    expect_poses(&read(&path).poses, &poses());
    // HybrIK's rows of 24 matrices.
    write_npy(&path, &matrices().into_shape_with_order((FRAMES, 216)).unwrap()).unwrap();
    expect_poses(&read(&path).poses, &poses());
    let mut scaled = matrices();
    scaled.slice_mut(s![3, 4, .., ..]).mapv_inplace(|x| 2.0 * x);
    write_npy(&path, &scaled).unwrap();
    assert!(error(&path).contains("joint 4 in frame 3 is no rotation"), "{}", error(&path));
}

#[test]
fn tables_are_told_by_their_width() {
    let files = Files::new();
    let path = files.path("a.npy");
    let ones = |columns: usize| Array2::<f64>::ones((FRAMES, columns));
    let zeros = |columns: usize| Array2::<f64>::zeros((FRAMES, columns));
    let join = |parts: &[Array2<f64>]| {
        let views: Vec<_> = parts.iter().map(|part| part.view()).collect();
        ndarray::concatenate(Axis(1), &views).unwrap()
    };
    write_npy(&path, &join(&[poses(), ones(3)])).unwrap();
    let file = read(&path);
    assert_eq!(file.translations.as_ref().unwrap()[(1, 2)], 1.0);
    assert!(notes(&file).contains("75 columns read as pose and translation"));
    // HMR: camera, pose, shape.
    write_npy(&path, &join(&[zeros(3), poses(), ones(10)])).unwrap();
    let file = read(&path);
    expect_poses(&file.poses, &poses());
    assert_eq!((file.betas, file.translations), (vec![1.0; 10], None));
    // Motion-X: body, hands and face, then translation and shape.
    write_npy(&path, &join(&[padded(66), zeros(243), 2.0 * ones(3), ones(10)])).unwrap();
    let file = read(&path);
    expect_poses(&file.poses, &body());
    assert_eq!((file.translations.unwrap()[(0, 0)], file.betas.len()), (2.0, 10));
    // HumanML3D's features are no rotations of SMPL.
    write_npy(&path, &zeros(263)).unwrap();
    assert!(error(&path).contains("features of HumanML3D"), "{}", error(&path));
}

#[test]
fn aist_is_divided_by_its_scale() {
    let files = Files::new();
    let dance = Py::dict([
        ("smpl_poses", Py::array(&poses())),
        ("smpl_trans", Py::array(&Array2::from_elem((FRAMES, 3), 93.0))),
        ("smpl_scaling", Py::array(&Array1::from_elem(1, 93.0))),
    ]);
    let file = read(&files.bytes("dance.pkl", &pickle(&dance, false)));
    expect_poses(&file.poses, &poses());
    assert_eq!(file.translations.unwrap(), Array2::<f64>::ones((FRAMES, 3)));
}

#[test]
fn motion_diffusion_has_frames_last() {
    let files = Files::new();
    let all = matrices();
    let six = Array3::from_shape_fn((24, 6, FRAMES), |(joint, k, frame)| {
        all[[frame, joint, k / 3, k % 3]]
    });
    let sample = Py::dict([
        ("motion", Py::array(&Array3::zeros((25, 6, FRAMES)))),
        ("thetas", Py::array(&six)),
        ("root_translation", Py::array(&Array2::ones((3, FRAMES)))),
        ("text", Py::Text("a person walks")),
    ]);
    let path = files.path("sample00_rep00_smpl_params.npy");
    object_npy(&path, pickle(&sample, false));
    let file = read(&path);
    expect_poses(&file.poses, &poses());
    assert_eq!(file.translations.unwrap(), Array2::<f64>::ones((FRAMES, 3)));
    // Its results are positions only.
    let results = Py::dict([("motion", Py::array(&ArrayD::zeros(vec![3, 22, 3, FRAMES])))]);
    object_npy(&path, pickle(&results, false));
    assert!(error(&path).contains("`motion` [3, 22, 3, 6] are positions"), "{}", error(&path));
}

#[test]
fn text_is_read_in_its_dialects() {
    let files = Files::new();
    let rows = |separator: &str| -> String {
        let row = |row: ndarray::ArrayView1<f64>| {
            row.iter().map(ToString::to_string).collect::<Vec<_>>().join(separator) + "\r\n"
        };
        poses().rows().into_iter().map(row).collect()
    };
    for (name, text) in [
        ("a.csv", rows(",")),
        ("bom.csv", format!("\u{feff}{}", rows(","))),
        ("names.csv", format!("{}\n\n{}", vec!["a"; 72].join(","), rows(";"))),
        ("spaces.txt", format!("# poses\n{}", rows("  "))),
    ] {
        expect_poses(&read(&files.bytes(name, text.as_bytes())).poses, &poses());
    }
    let numbers: Vec<Vec<f64>> = poses().rows().into_iter().map(|row| row.to_vec()).collect();
    let json = serde_json::json!({"fps": 25, "poses": numbers}).to_string();
    let file = read(&files.bytes("a.json", json.as_bytes()));
    assert_eq!(file.frame_rate, Some(25.0));
    expect_poses(&file.poses, &poses());
    let people =
        serde_json::json!([{"id": 3, "poses": [numbers[0]]}, {"id": 4, "poses": [numbers[1]]}]);
    let path = files.bytes("people.json", people.to_string().as_bytes());
    assert_eq!(person(&path, "4").frames(), 1);
    let short = files.bytes("short.csv", format!("{}1,2\n", rows(",")).as_bytes());
    assert!(error(&short).contains("line 7"), "{}", error(&short));
}

#[test]
fn archives_of_objects_are_read() {
    let files = Files::new();
    let path = files.path("results.npz");
    // An object array within an archive, which this library does not write.
    let npy = files.path("results.npy");
    object_npy(&npy, pickle(&Py::dict([("smpl_thetas", Py::array(&poses()))]), false));
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    archive.start_file("results.npy", zip::write::SimpleFileOptions::default()).unwrap();
    std::io::Write::write_all(&mut archive, &std::fs::read(&npy).unwrap()).unwrap();
    archive.finish().unwrap();
    expect_poses(&read(&path).poses, &poses());
    // A single pose under either name.
    for name in ["pose", "poses"] {
        let mut archive = NpzWriter::create(&path).unwrap();
        archive.add(name, &poses().row(2).to_owned()).unwrap();
        archive.finish().unwrap();
        expect_poses(&read(&path).poses, &poses().slice(s![2..3, ..]).to_owned());
    }
}

#[test]
fn smpl_files_keep_motion_shape_and_displacements() {
    let files = Files::new();
    let motion = BodyMotion::new(24.0, poses(), Array2::ones((FRAMES, 3))).unwrap();
    let offsets = Array2::from_elem((5, 3), 0.25);
    let path = files.path("a.smpl");
    let file = SmplFile {
        motion: &motion,
        betas: &[0.5, -1.0],
        gender: Some("female"),
        offsets: Some(&offsets),
    };
    file.save(&path).unwrap();
    let found = read(&path);
    assert_eq!((found.frame_rate, found.gender.as_deref()), (Some(24.0), Some("female")));
    assert_eq!(
        (found.betas[..2].to_vec(), found.offsets.as_ref()),
        (vec![0.5, -1.0], Some(&offsets))
    );
    assert!((&found.poses - &motion.poses).iter().all(|d| d.abs() < 1e-6));
    assert!(SmplFile { betas: &[0.0; 11], ..file }.save(&path).is_err());
    // The types that the format asks for.
    let mut archive = crate::npy::Npz::open(&path).unwrap();
    for (name, dtype) in [("codecVersion", "<i4"), ("frameRate", "<f4"), ("bodyPose", "<f4")] {
        assert_eq!(archive.header(name).unwrap().dtype.to_string(), dtype);
    }
}
