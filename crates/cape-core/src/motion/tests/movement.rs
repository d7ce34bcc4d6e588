//! Motions in other axes and at other rates.

use super::*;

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
