//! Files as other programs write them, each with its outcome. Every builder holds the same movement.

use std::{f64::consts::PI, path::Path};

use glam::{DQuat, DVec3};
use ndarray::{Array1, Array2, Array3, ArrayD, Axis, s, stack};

use super::{
    test_files::{FRAMES, Files, Py, matrices, object_npy, padded, pickle, poses, turned},
    *,
};
use crate::{
    joints::rotation,
    npy::{NpzWriter, write_npy},
};

fn read(path: &Path) -> MotionFile {
    read_motion(path, &MotionOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn error(path: &Path) -> String {
    read_motion(path, &MotionOptions::default()).unwrap_err().to_string()
}

fn person(path: &Path, name: &str) -> MotionFile {
    let options = MotionOptions { person: Some(name.to_owned()), ..MotionOptions::default() };
    read_motion(path, &options).unwrap_or_else(|error| panic!("{error}"))
}

/// Largest angle between rotations of two tables of axis-angles, radians.
#[track_caller]
fn expect_poses(found: &Array2<f64>, expected: &Array2<f64>) {
    assert_eq!(found.dim(), expected.dim());
    for (a, b) in found.rows().into_iter().zip(expected.rows()) {
        for joint in 0..24 {
            let of = |row: &ndarray::ArrayView1<f64>| {
                rotation([0, 1, 2].map(|axis| row[3 * joint + axis]))
            };
            assert!(of(&a).abs_diff_eq(of(&b), 1e-9), "joint {joint}: {a} {b}");
        }
    }
}

/// The movement without hands, as of files of 22 body joints.
fn body() -> Array2<f64> {
    let mut expected = poses();
    expected.slice_mut(s![.., 66..]).fill(0.0);
    expected
}

fn notes(file: &MotionFile) -> String {
    file.notes.join("; ")
}

#[test]
fn amass_has_z_up_its_rate_and_sixteen_betas() {
    let files = Files::new();
    let turn = UpAxis::Z.to_y().inverse();
    let mut wide = padded(156);
    wide.slice_mut(s![.., ..3]).assign(&turned(turn).slice(s![.., ..3]));
    for rate in ["mocap_framerate", "mocap_frame_rate"] {
        let path = files.npz("walk_poses.npz", |arrays| {
            let way = Array2::from_shape_fn((FRAMES, 3), |(f, k)| f as f64 * [0.0, -0.01, 0.0][k]);
            arrays.add("poses", &wide).add("trans", &way).number(rate, 120.0);
            arrays.add("betas", &Array1::from_iter((0..16).map(f64::from)));
            arrays.add("dmpls", &Array2::zeros((FRAMES, 8))).text("gender", "male");
        });
        let file = read(&path);
        assert_eq!((file.up, file.frame_rate, file.joints), (UpAxis::Z, Some(120.0), 52));
        assert_eq!((file.betas.len(), file.betas_for(10).len()), (16, 10));
        assert_eq!(file.gender.as_deref(), Some("male"));
        assert!(notes(&file).contains("30 hand joints, 8 soft-tissue coefficients"), "{file:?}");
        let motion = file.motion(None, [0.0; 3]).unwrap();
        expect_poses(&motion.poses, &body());
        // From -y, which is to the front of a body that stands along z, to +z.
        assert!((motion.translations[(FRAMES - 1, 2)] - 0.05).abs() < 1e-12);
        assert!(motion.translations.column(1).iter().all(|y| y.abs() < 1e-12));
    }
}

#[test]
fn newer_amass_of_smplx_counts_what_it_leaves_out() {
    let files = Files::new();
    let mut wide = padded(165);
    wide.slice_mut(s![.., ..3]).assign(&turned(UpAxis::Z.to_y().inverse()).slice(s![.., ..3]));
    let path = files.npz("walk_stageii.npz", |arrays| {
        arrays.text("gender", "neutral").text("surface_model_type", "smplx");
        arrays.number("mocap_frame_rate", 120.0).add("trans", &Array2::zeros((FRAMES, 3)));
        arrays.add("poses", &wide).add("betas", &Array1::zeros(16)).number("num_betas", 16.0);
        arrays.add("root_orient", &Array2::zeros((FRAMES, 3)));
        arrays.add("pose_body", &padded(66).slice(s![.., 3..]).to_owned());
        arrays.add("pose_hand", &Array2::zeros((FRAMES, 90)));
        arrays.add("pose_jaw", &Array2::zeros((FRAMES, 3)));
    });
    let file = read(&path);
    assert_eq!((file.up, file.joints), (UpAxis::Z, 55));
    assert!(notes(&file).contains("3 joints of jaw and eyes, 30 hand joints"), "{}", notes(&file));
    expect_poses(&file.motion(None, [0.0; 3]).unwrap().poses, &body());
}

#[test]
fn a_body_of_amass_layout_that_stands_along_y_stays() {
    let files = Files::new();
    let path = files.npz("captured.npz", |arrays| {
        arrays.add("poses", &padded(156)).add("trans", &Array2::zeros((FRAMES, 3)));
        arrays.add("betas", &Array2::zeros((FRAMES, 300))).number("mocap_framerate", 60.0);
    });
    let file = read(&path);
    assert_eq!((file.up, file.betas.len()), (UpAxis::Y, 300));
    assert!(notes(&file).contains("stands along y") && notes(&file).contains("--up"));
    assert!(notes(&file).contains("betas in 6 rows"));
    let given = MotionOptions { up: Some(UpAxis::Z), ..MotionOptions::default() };
    assert_eq!(read_motion(&path, &given).unwrap().up, UpAxis::Z);
}

#[test]
fn the_up_axis_is_found_from_the_posture() {
    let files = Files::new();
    for up in UpAxis::ALL {
        let path = files.path("poses.npy");
        write_npy(&path, &turned(up.to_y().inverse())).unwrap();
        let file = read(&path);
        assert_eq!(file.up, up);
        assert_eq!(notes(&file).contains("taken as up"), up != UpAxis::Y, "{}", notes(&file));
        expect_poses(&file.motion(None, [0.0; 3]).unwrap().poses, &poses());
    }
    // Lying on the side tells nothing.
    let path = files.path("lying.npy");
    write_npy(&path, &turned(DQuat::from_rotation_z(PI / 2.0))).unwrap();
    let file = read(&path);
    assert_eq!(file.up, UpAxis::Y);
    assert!(notes(&file).contains("does not tell"), "{}", notes(&file));
}

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
    assert!(error(&path).contains("an array [6, 263]"), "{}", error(&path));
}

#[test]
fn positions_of_joints_are_not_taken_for_rotations() {
    let files = Files::new();
    let mut positions = Array3::<f64>::zeros((FRAMES, 22, 3));
    for frame in 0..FRAMES {
        let turn = DQuat::from_rotation_y(0.1 * frame as f64);
        for joint in 1..22 {
            let parent = crate::joints::PARENTS[joint].unwrap();
            let bone = turn * DVec3::new(0.02 * joint as f64, 0.1, 0.03);
            for axis in 0..3 {
                positions[(frame, joint, axis)] = positions[(frame, parent, axis)] + bone[axis];
            }
        }
    }
    let path = files.path("joints.npy");
    write_npy(&path, &positions).unwrap();
    assert!(error(&path).contains("positions of joints"), "{}", error(&path));
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
    assert!(error(&path).contains("motion [3, 22, 3, 6]"), "{}", error(&path));
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
fn files_without_poses_say_what_they_have() {
    let files = Files::new();
    // AMASS's file of a subject's shape.
    let path = files.npz("male_stageii.npz", |arrays| {
        arrays.text("gender", "male").add("betas", &Array1::zeros(10));
    });
    let message = error(&path);
    assert!(message.contains("the file has gender (text), betas [10]"), "{message}");
    assert!(message.contains("global_orient"), "{message}");
    // SMPLify-X before decoding by its pose prior.
    let encoded = Py::dict([("body_pose", Py::array(&Array2::zeros((1, 32))))]);
    let path = files.bytes("000.pkl", &pickle(&encoded, false));
    assert!(error(&path).contains("body_pose [1, 32]"), "{}", error(&path));
    for (bytes, expected) in [
        (&b"HIERARCHY\nROOT Hips\n"[..], "BVH"),
        (b"<!DOCTYPE html>", "web page"),
        (b"version https://git-lfs.github.com/spec/v1\n", "Git LFS"),
        (b"", "empty"),
        (b"\x00\x01\x02\xff\xfe", "unknown kind"),
        (b"{\"poses\": [[1, 2", "not JSON"),
    ] {
        let path = files.bytes("a.npz", bytes);
        assert!(error(&path).contains(expected), "{}", error(&path));
    }
    let mut broken = poses();
    broken[(1, 28)] = f64::NAN;
    let path = files.path("nan.npy");
    write_npy(&path, &broken).unwrap();
    assert!(error(&path).contains("number 28 of frame 1"), "{}", error(&path));
    write_npy(&path, &Array2::<f64>::zeros((0, 72))).unwrap();
    assert!(error(&path).contains("no pose"), "{}", error(&path));
    let path = files.npz("short.npz", |arrays| {
        arrays.add("poses", &poses()).add("trans", &Array2::zeros((FRAMES - 1, 3)));
    });
    assert!(error(&path).contains("`trans`: shape [5, 3], expected [6, 3]"), "{}", error(&path));
    // PyTorch's tensors and files.
    let mut tensor = vec![0x80, 4, 0x8c, 12];
    tensor.extend(b"torch._utils\x8c\x12_rebuild_tensor_v2\x93.");
    let path = files.bytes("tensors.pkl", &tensor);
    assert!(error(&path).contains(".cpu().numpy()"), "{}", error(&path));
    let mut archive = zip::ZipWriter::new(std::fs::File::create(&path).unwrap());
    archive.start_file("archive/data.pkl", zip::write::SimpleFileOptions::default()).unwrap();
    archive.finish().unwrap();
    assert!(error(&path).contains("archive/data.pkl"), "{}", error(&path));
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

#[test]
fn turning_a_motion_turns_the_posed_body() {
    let body = cape_synth::synthetic_body();
    let shape = body.rest_shape(&[0.5]).unwrap();
    let pelvis = body.rest_joints(&shape).unwrap();
    let pelvis = [0, 1, 2].map(|axis| pelvis[(0, axis)]);
    let translations = Array2::from_shape_fn((FRAMES, 3), |(f, k)| 0.3 * f as f64 - k as f64);
    let motion = BodyMotion::new(30.0, poses(), translations).unwrap();
    for up in UpAxis::ALL {
        let turned = motion.turned_upright(up, pelvis);
        for frame in [0, FRAMES - 1] {
            let posed = |motion: &BodyMotion| {
                let pose = motion.poses.row(frame).to_vec();
                body.pose_shape(&shape, &pose, motion.translation(frame), None).unwrap().vertices
            };
            let (before, after) = (posed(&motion), posed(&turned));
            for (a, b) in before.rows().into_iter().zip(after.rows()).step_by(500) {
                let a = up.to_y() * DVec3::new(a[0], a[1], a[2]);
                assert!(a.abs_diff_eq(DVec3::new(b[0], b[1], b[2]), 1e-9));
            }
        }
    }
}

#[test]
fn resampling_interpolates_on_the_arc() {
    // A steady turn about one axis and a straight way have a closed form.
    let axis = DVec3::new(1.0, 2.0, -0.5).normalize();
    let angle = |t: f64| -1.2 + 2.0 * t;
    let at = |t: f64| (axis * angle(t)).to_array();
    let mut poses = Array2::zeros((31, 72));
    let mut translations = Array2::zeros((31, 3));
    for frame in 0..31 {
        let t = frame as f64 / 30.0;
        for k in 0..3 {
            poses[(frame, 12 + k)] = at(t)[k];
            translations[(frame, k)] = t * (k as f64 + 1.0);
        }
    }
    let motion = BodyMotion::new(30.0, poses, translations).unwrap();
    for rate in [120.0, 24.0, 15.0, 59.94] {
        let other = motion.resampled(rate).unwrap();
        assert_eq!(other.frames(), (rate * 1.0 + 1e-6) as usize + 1);
        for frame in 0..other.frames() {
            let t = frame as f64 / rate;
            for k in 0..3 {
                assert!((other.poses[(frame, 12 + k)] - at(t)[k]).abs() < 1e-9);
                assert!((other.translations[(frame, k)] - t * (k as f64 + 1.0)).abs() < 1e-9);
            }
        }
    }
    assert_eq!(motion.resampled(30.0).unwrap(), motion);
    assert!(motion.resampled(0.0).is_err() && motion.resampled(1e12).is_err());
    // Across π the shorter arc is taken: from 170° to -170° over 180°.
    let mut poses = Array2::zeros((2, 72));
    (poses[(0, 1)], poses[(1, 1)]) = (170_f64.to_radians(), -170_f64.to_radians());
    let motion = BodyMotion::new(1.0, poses, Array2::zeros((2, 3))).unwrap();
    let middle = motion.resampled(2.0).unwrap().poses[(1, 1)];
    assert!((middle.abs() - PI).abs() < 1e-9, "{middle}");
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
