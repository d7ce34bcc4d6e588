//! Rotations on the host, in f64, for packing.

/// Joints that clothing depends on, in the order of the pose feature.
pub const CLOTHING_JOINTS: [usize; 14] = [1, 2, 3, 4, 5, 6, 9, 12, 13, 14, 16, 17, 18, 19];

/// Rotation matrix (row-major) of an axis-angle vector in radians: Rodrigues' formula, by its
/// series where the angle is too small to divide by.
pub fn rotation_matrix([x, y, z]: [f64; 3]) -> [f64; 9] {
    let square = x * x + y * y + z * z;
    let angle = square.sqrt();
    let (a, b) = if angle < 1e-4 {
        (1.0 - square / 6.0, 0.5 - square / 24.0)
    } else {
        (angle.sin() / angle, (1.0 - angle.cos()) / square)
    };
    [
        1.0 - b * (y * y + z * z),
        b * x * y - a * z,
        b * x * z + a * y,
        b * x * y + a * z,
        1.0 - b * (x * x + z * z),
        b * y * z - a * x,
        b * x * z - a * y,
        b * y * z + a * x,
        1.0 - b * (x * x + y * y),
    ]
}

/// Rotation matrices (row-major) of a pose of 24 axis-angle vectors.
pub fn pose_rotations(pose: &[f64; 72]) -> [f64; 216] {
    let mut rotations = [0.0; 216];
    let (vectors, _) = pose.as_chunks::<3>();
    let (matrices, _) = rotations.as_chunks_mut::<9>();
    for (matrix, &vector) in matrices.iter_mut().zip(vectors) {
        *matrix = rotation_matrix(vector);
    }
    rotations
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn quarter_turns_and_tiny_angles() {
        use std::f64::consts::FRAC_PI_2;
        let close = |a: [f64; 9], b: [f64; 9]| {
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-15), "{a:?} {b:?}");
        };
        close(rotation_matrix([0.0; 3]), [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        let about_z = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0];
        close(rotation_matrix([0.0, 0.0, FRAC_PI_2]), about_z);
        let about_x = [1.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0];
        close(rotation_matrix([FRAC_PI_2, 0.0, 0.0]), about_x);
        // Both sides of the switch to the series agree.
        let (below, above) = (0.999_999_9e-4, 1.000_000_1e-4);
        let (a, b) = (rotation_matrix([below, 0.0, 0.0]), rotation_matrix([above, 0.0, 0.0]));
        assert!((a[7] / below - b[7] / above).abs() < 1e-12);
        assert!(((1.0 - a[8]) / below.powi(2) - (1.0 - b[8]) / above.powi(2)).abs() < 1e-7);
    }

    #[test]
    fn rotations_are_orthonormal_and_keep_their_axis() {
        for vector in [[0.3, -1.2, 0.7], [2.0, 2.0, -1.5], [1e-5, 2e-5, -3e-5], [0.0, 3.1, 0.0]] {
            let r = rotation_matrix(vector);
            for i in 0..3 {
                for j in 0..3 {
                    let dot: f64 = (0..3).map(|k| r[3 * i + k] * r[3 * j + k]).sum();
                    assert!((dot - f64::from(u8::from(i == j))).abs() < 1e-14);
                }
                let turned: f64 = (0..3).map(|k| r[3 * i + k] * vector[k]).sum();
                assert!((turned - vector[i]).abs() < 1e-14);
            }
        }
    }

    /// The release's demo poses come with their rotation matrices.
    #[test]
    fn agrees_with_the_reference() {
        let Some(reference) = std::env::var_os("CAPE_REFERENCE") else { return };
        let path = std::path::Path::new(&reference).join("smpl/demo_pose_params.npz");
        let mut file = cape_core::npy::Npz::open(path).unwrap();
        let (pose, rot) = (file.f64("pose").unwrap(), file.f64("rot").unwrap());
        assert!(!pose.is_empty());
        for (pose, rot) in pose.outer_iter().zip(rot.outer_iter()) {
            let pose: [f64; 72] = pose.as_slice().unwrap().try_into().unwrap();
            let got = pose_rotations(&pose);
            assert!(got.iter().zip(rot).all(|(a, b)| (a - b).abs() < 1e-6));
        }
    }
}
