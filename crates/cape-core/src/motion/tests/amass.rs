//! AMASS, and the axis that points up.

use super::*;

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
