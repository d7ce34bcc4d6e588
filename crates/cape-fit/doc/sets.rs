// Data for the examples in the documentation of this crate.

/// Vertices of the synthetic body, metres, and its triangles.
#[allow(dead_code)]
fn person() -> (Vec<glam::DVec3>, Vec<[u32; 3]>) {
    let body = cape_synth::synthetic_body();
    let rows = body.v_template.rows();
    (rows.into_iter().map(|v| glam::DVec3::new(v[0], v[1], v[2])).collect(), body.faces)
}

/// A square of `side` metres, 2 m in front of the camera.
#[allow(dead_code)]
fn square(side: f64) -> (Vec<glam::DVec3>, Vec<[u32; 3]>) {
    let corners = [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)];
    let corners = corners.map(|(x, y)| glam::DVec3::new(side * x, side * y, -2.0));
    (corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]])
}

/// A walking body 3.5 m in front of the camera, and the projections of its joints.
#[allow(dead_code)]
fn seen(
    model: &cape_core::SmplModel,
    camera: &cape_fit::PinholeCamera,
) -> cape_fit::Result<(cape_fit::BodyParameters, cape_fit::Keypoints)> {
    use cape_fit::{BodyParameters, KeypointLayout, Keypoint, Keypoints, Skeleton};
    use cape_synth::{Motion, MotionStyle};

    let pose = Motion::WalkMarch.pose(&MotionStyle::default(), 0.6).to_vec();
    let mut body = BodyParameters::new(pose, vec![0.8, -0.6])?;
    body.transl = [0.1, 0.2, -3.5];
    let skeleton = Skeleton::new(model)?;
    let posed = skeleton.pose(&body.betas, &body.pose, body.transl.into())?;
    let points = posed.joints().iter().map(|&joint| {
        let at = camera.project(joint);
        Keypoint { x: at.x, y: at.y, confidence: 0.9 }
    });
    let keypoints = Keypoints::new(KeypointLayout::Smpl24, points.collect())?;
    Ok((body, keypoints))
}
