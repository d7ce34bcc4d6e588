//! SMPL with the additive clothing term as a graph.

use cape_core::{SmplModel, smpl::ClothingMask};
use ndarray::{Array3, Axis};

use crate::{
    Error, OnnxModel, Result, WeightPrecision,
    graph::{GraphBuilder, Value, single},
    metadata::describe_body,
    rotations::{IDENTITY, POSE, pose_rotations},
};

/// Posed body: `betas` `[batch, B]`, `pose` `[batch, 72]` in axis-angle, `translation` `[batch, 3]` and
/// `displacement` `[batch, V, 3]`, which applies at the vertices of `clothing`, to `vertices`
/// `[batch, V, 3]` and `joints` `[batch, 24, 3]`, metres (CAPE eq. 1–4).
///
/// Template, joints and blend weights are kept in single precision, as their rounding would move
/// vertices by up to a millimetre.
///
/// ```
/// use cape_core::ClothingMask;
/// use cape_onnx::WeightPrecision;
///
/// let body = cape_synth::synthetic_body();
/// let mask = ClothingMask::from_weights(&body)?;
/// let graph = cape_onnx::export_body(&body, &mask, WeightPrecision::Single)?;
/// assert_eq!(graph.inputs()[0].shape, [None, Some(10)]);
/// assert_eq!(graph.outputs()[1].shape, [None, Some(24), Some(3)]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If the body is invalid or does not have SMPL's joints, or the mask is of another body.
pub fn export_body(
    body: &SmplModel,
    clothing: &ClothingMask,
    precision: WeightPrecision,
) -> Result<OnnxModel> {
    body.validate()?;
    let (vertices, joints) = (body.vertices(), body.joints());
    if joints != cape_core::joints::JOINTS || clothing.covered().len() != vertices {
        return Err(Error::Core(cape_core::Error::Argument(format!(
            "a body of {vertices} vertices and {joints} joints with a clothing mask of {} vertices: \
             expected {} joints, and equally many vertices",
            clothing.covered().len(),
            cape_core::joints::JOINTS
        ))));
    }
    let mut graph = GraphBuilder::new("smpl", precision);
    let betas = graph.input("betas", &[body.betas()]);
    let pose = graph.input(POSE, &[3 * joints]);
    let translation = graph.input("translation", &[3]);
    let displacement = graph.input("displacement", &[vertices, 3]);

    let all: Vec<usize> = (0..joints).collect();
    let rotations = pose_rotations(&mut graph, &pose, &all);
    let (rest, rest_joints) = rest_shape(&mut graph, body, &betas, &rotations)?;
    let covered: Vec<f32> = clothing.covered().iter().map(|&covered| f32::from(covered)).collect();
    let covered = graph.constants(&[vertices, 1], &covered);
    let clothes = graph.mul(&displacement, &covered);
    let rest = graph.add(&rest, &clothes);

    let chain = joint_transforms(&mut graph, &body.parents, &rotations, &rest_joints);
    let translation = graph.reshape(&translation, &[1, 3]);
    let at = graph.select(&chain, &[3], 2);
    let at = graph.reshape(&at, &[joints, 3]);
    let at = graph.add(&at, &translation);
    let posed = skin(&mut graph, body, &rest, (&chain, &rest_joints));
    let posed = graph.add(&posed, &translation);
    graph.output("vertices", &posed, &[vertices, 3]);
    graph.output("joints", &at, &[joints, 3]);
    let text = "SMPL body with displacements of clothing (CAPE, equations 1 to 4)";
    Ok(describe_body(graph.finish(text), precision))
}

/// Unposed vertices `T̄ + B_S(β) + B_P(θ)`, `[batch, V, 3]`, and rest joints `J(β)`, `[batch, J, 3]`.
fn rest_shape(
    graph: &mut GraphBuilder,
    body: &SmplModel,
    betas: &Value,
    rotations: &Value,
) -> Result<(Value, Value)> {
    let (v, j, b) = (body.vertices(), body.joints(), body.betas());
    // [V, 3, K] → [K, V, 3]
    let rows = |directions: &Array3<f64>| -> Vec<f32> {
        let directions = directions.view().permuted_axes([2, 0, 1]);
        directions.iter().map(|&x| x as f32).collect()
    };
    let directions = graph.weights("shapedirs", &[b, 3 * v], &rows(&body.shapedirs))?;
    let shape = graph.matmul(betas, &directions);

    let turned: Vec<usize> = (1..j).collect();
    let turned = graph.select(rotations, &turned, 1);
    let identity = graph.constants(&[9], &IDENTITY);
    let feature = graph.sub(&turned, &identity);
    let feature = graph.reshape(&feature, &[9 * (j - 1)]);
    let directions = graph.weights("posedirs", &[9 * (j - 1), 3 * v], &rows(&body.posedirs))?;
    let correction = graph.matmul(&feature, &directions);

    let offsets = graph.add(&shape, &correction);
    let offsets = graph.reshape(&offsets, &[v, 3]);
    let template = graph.constants(&[v, 3], &single(&body.v_template));
    let rest = graph.add(&offsets, &template);

    let directions: Vec<f32> = body
        .shapedirs
        .axis_iter(Axis(2))
        .flat_map(|direction| single(&body.joint_regressor.dot(&direction)))
        .collect();
    let directions = graph.constants(&[b, 3 * j], &directions);
    let moved = graph.matmul(betas, &directions);
    let moved = graph.reshape(&moved, &[j, 3]);
    let joints = single(&body.joint_regressor.dot(&body.v_template));
    let joints = graph.constants(&[j, 3], &joints);
    Ok((rest, graph.add(&moved, &joints)))
}

/// Global transforms of the joint frames as columns: `[batch, J, 4, 3]`, of which the last is the
/// position.
fn joint_transforms(
    graph: &mut GraphBuilder,
    parents: &[Option<usize>],
    rotations: &Value,
    rest_joints: &Value,
) -> Value {
    let j = parents.len();
    // Position relative to the parent; the root's is its own.
    let below: Vec<usize> = (1..j).collect();
    let above: Vec<usize> = parents.iter().flatten().copied().collect();
    let root = graph.select(rest_joints, &[0], 1);
    let children = graph.select(rest_joints, &below, 1);
    let above = graph.select(rest_joints, &above, 1);
    let offsets = graph.sub(&children, &above);
    let offsets = graph.concat(&[root, offsets], 1);
    let offsets = graph.reshape(&offsets, &[j, 3, 1]);
    let turns = graph.reshape(rotations, &[j, 3, 3]);
    let local = graph.concat(&[turns, offsets], 3);
    // Homogeneous: [batch, J, 4, 4].
    let local = graph.append_row_of_zeros(&local);
    let mut corner = [0.0; 16];
    corner[15] = 1.0;
    let corner = graph.constants(&[4, 4], &corner);
    let local = graph.add(&local, &corner);

    let mut depth_of = vec![0; j];
    for (joint, parent) in parents.iter().enumerate() {
        depth_of[joint] = parent.map_or(0, |parent| depth_of[parent] + 1);
    }
    let at_depth = |depth: usize| (0..j).filter(|&joint| depth_of[joint] == depth).collect();
    let mut before: Vec<usize> = at_depth(0);
    let mut global = vec![graph.select(&local, &before, 1)];
    let mut order = before.clone();
    loop {
        let joints: Vec<usize> = at_depth(global.len());
        if joints.is_empty() {
            break;
        }
        let place = |joint: &usize| before.iter().position(|at| Some(*at) == parents[*joint]);
        let places: Vec<usize> = joints.iter().filter_map(place).collect();
        let above = graph.select(&global[global.len() - 1], &places, 1);
        let own = graph.select(&local, &joints, 1);
        global.push(graph.matmul(&above, &own));
        order.extend(&joints);
        before = joints;
    }
    let global = graph.concat(&global, 1);
    let mut place = vec![0; j];
    for (at, joint) in order.into_iter().enumerate() {
        place[joint] = at;
    }
    let global = graph.select(&global, &place, 1);
    let rows = graph.select(&global, &[0, 1, 2], 2);
    graph.apply("Transpose", &[&rows], &[("perm", crate::graph::Attribute::Ints(&[0, 1, 3, 2]))])
}

/// Linear blend skinning of rest vertices.
fn skin(
    graph: &mut GraphBuilder,
    body: &SmplModel,
    rest: &Value,
    (chain, rest_joints): (&Value, &Value),
) -> Value {
    let (v, j) = (body.vertices(), body.joints());
    // Relative to rest positions: the translation is less the rotated rest joint.
    let columns = graph.select(chain, &[0, 1, 2], 2);
    let at = graph.select(chain, &[3], 2);
    let rest_joints = graph.reshape(rest_joints, &[j, 3, 1]);
    let moved = graph.mul(&columns, &rest_joints);
    let moved = graph.reduce("ReduceSum", &moved, 2, true);
    let shift = graph.sub(&at, &moved);
    let transforms = graph.concat(&[columns, shift], 2);
    let transforms = graph.reshape(&transforms, &[j, 12]);

    let weights = graph.constants(&[v, j], &single(&body.weights));
    let blended = graph.matmul(&weights, &transforms);
    let columns = graph.split(&blended, 4, 2);
    let coordinates = graph.split(rest, 3, 2);
    let mut posed = columns[3].clone();
    for (column, coordinate) in columns.iter().zip(&coordinates) {
        let term = graph.mul(column, coordinate);
        posed = graph.add(&posed, &term);
    }
    posed
}
