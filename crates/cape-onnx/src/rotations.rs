//! Rotation matrices of poses.

use cape_core::joints::JOINTS;

use crate::graph::{GraphBuilder, Value};

/// Name of the input of poses: axis-angles of all joints relative to their parents, radians,
/// `[batch, 72]`.
pub(crate) const POSE: &str = "pose";

/// Smallest angle that is divided by, radians; below it `sin θ / θ` and `(1 − cos θ) / θ²` are 1 and ½
/// in single precision.
const SMALLEST_ANGLE: f32 = 1e-6;

/// 3 × 3 identity matrix, row-major.
pub(crate) const IDENTITY: [f32; 9] = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];

/// Rotation matrices, row-major, `[batch, joints, 9]`, of some joints of a pose `[batch, 3·J]` by
/// Rodrigues' formula `R = (1 − b θ²) I + a [v]ₓ + b v vᵀ` with `a = sin θ / θ` and
/// `b = (1 − cos θ) / θ² = ½ (sin ½θ / ½θ)²`.
pub(crate) fn pose_rotations(graph: &mut GraphBuilder, pose: &Value, joints: &[usize]) -> Value {
    let vectors = graph.reshape(pose, &[JOINTS, 3]);
    let vectors = graph.select(&vectors, joints, 1);
    let squares = graph.mul(&vectors, &vectors);
    let squared = graph.reduce("ReduceSum", &squares, 2, true);
    let angle = graph.apply("Sqrt", &[&squared], &[]);
    let smallest = graph.scalar(SMALLEST_ANGLE);
    let angle = graph.apply("Max", &[&angle, &smallest], &[]);

    let sine = graph.apply("Sin", &[&angle], &[]);
    let a = graph.div(&sine, &angle);
    let half = graph.scale(&angle, 0.5);
    let half_sine = graph.apply("Sin", &[&half], &[]);
    let ratio = graph.div(&half_sine, &half);
    let b = graph.mul(&ratio, &ratio);
    let b = graph.scale(&b, 0.5);

    // v · generators = [v]ₓ, row-major.
    let generators = graph.constants(
        &[3, 9],
        &[
            0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 0.0, 1.0, 0.0, //
            0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, //
            0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0,
        ],
    );
    let cross = graph.matmul(&vectors, &generators);
    let cross = graph.mul(&cross, &a);
    let column = graph.reshape(&vectors, &[joints.len(), 3, 1]);
    let row = graph.reshape(&vectors, &[joints.len(), 1, 3]);
    let outer = graph.mul(&column, &row);
    let outer = graph.reshape(&outer, &[joints.len(), 9]);
    let outer = graph.mul(&outer, &b);
    let one = graph.scalar(1.0);
    let shrink = graph.mul(&b, &squared);
    let diagonal = graph.sub(&one, &shrink);
    let identity = graph.constants(&[9], &IDENTITY);
    let diagonal = graph.mul(&diagonal, &identity);
    let rotation = graph.add(&diagonal, &cross);
    graph.add(&rotation, &outer)
}
