// Data for the examples in the documentation of this crate.

/// An octahedron with its corners on the axes, `size` metres from the origin.
#[allow(dead_code)]
fn octahedron(size: f64) -> cape_core::geometry::SurfaceMesh {
    use glam::DVec3;

    let axes = [DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y, DVec3::Z, DVec3::NEG_Z];
    cape_core::geometry::SurfaceMesh {
        vertices: axes.map(|axis| size * axis).to_vec(),
        faces: vec![
            [0, 2, 4],
            [2, 1, 4],
            [1, 3, 4],
            [3, 0, 4],
            [2, 0, 5],
            [1, 2, 5],
            [3, 1, 5],
            [0, 3, 5],
        ],
    }
}

/// A patch of three vertices on the skin of a marching body, which rises by up to 2 cm as the left knee
/// bends, in 30 frames, and its association.
#[allow(dead_code)]
fn patch(
    body: &cape_core::SmplModel,
) -> cape_layer::Result<(cape_layer::LayerSet, cape_layer::Association)> {
    use cape_core::{BodyMotion, smpl::StandardPose};
    use cape_layer::{Association, BodyFrame, LayerSet, Sequence};
    use cape_synth::{Motion, MotionStyle};
    use ndarray::{Array2, Array3};

    let (style, frames, rate) = (MotionStyle::default(), 30, 30.0);
    let mut poses = Array2::zeros((frames, 72));
    for (frame, mut row) in poses.rows_mut().into_iter().enumerate() {
        let pose = Motion::WalkMarch.pose(&style, frame as f64 / rate);
        row.iter_mut().zip(pose).for_each(|(to, angle)| *to = angle);
    }
    let skin = [100, 101, 102];
    let shape = body.rest_shape(&[])?;
    let mut clothing = Array3::zeros((frames, 3, 3));
    for frame in 0..frames {
        let (pose, standard) = (poses.row(frame).to_vec(), StandardPose::default());
        let there = BodyFrame::new(body, &shape, &pose, [0.0; 3], &standard)?;
        let rise = 0.01 * pose[12] * glam::DVec3::Z;
        for (corner, &vertex) in skin.iter().enumerate() {
            let point = there.transforms[vertex].transform_point3(there.standard[vertex] + rise);
            (0..3).for_each(|axis| clothing[(frame, corner, axis)] = point[axis]);
        }
    }
    let march = Sequence {
        name: "anna_march".into(),
        clothing,
        betas: vec![],
        motion: BodyMotion::new(rate, poses, Array2::zeros((frames, 3)))?,
        parameters: vec![("length".into(), 0.85)],
    };
    let follows = Array2::from_shape_fn((3, 1), |(corner, _)| skin[corner] as u32);
    let association = Association::new(follows, Array2::ones((3, 1)), body.v_template.nrows())?;
    Ok((LayerSet::new(vec![[0, 1, 2]], vec![march])?, association))
}
