//! Pose directions that restore the volume that a body loses or gains at bent joints.

use glam::DVec3;

use super::{
    blend::{ENTRIES, cholesky, entries, rotation, samples, solve},
    rig::{Weights, share_below},
};
use cape_core::joints::JOINTS;

/// Ridge on the coefficients, in units of the mean square of the features.
const RIDGE: f64 = 1e-3;
/// Largest rotation against the sense in which knees and elbows bend, and backwards at the hips, radians.
const EXTENSION: [f64; 3] = [0.3, 0.3, 0.6];

/// Adds to the pose directions of each joint 1 to 23 displacements along the rest normals that keep the
/// body's volume while the joint turns.
///
/// A vertex with the share `s` of its weights at the joint and below moves by `4 s (1 − s) a n`, where
/// the amplitude `a` in metres is linear in the entries of `R − I`. Its coefficients are the
/// least-squares fit of the change of volume to zero, over rotations sampled in the joint's range.
pub(super) fn restore_volume(
    vertices: &[DVec3],
    faces: &[[u32; 3]],
    weights: &[Weights],
    joints: &[DVec3; JOINTS],
    directions: &mut [Vec<DVec3>],
) {
    let normals = vertex_normals(vertices, faces);
    for (joint, &centre) in joints.iter().enumerate().skip(1) {
        let shares: Vec<f64> = weights.iter().map(|row| share_below(row, joint)).collect();
        let bumps: Vec<DVec3> = shares
            .iter()
            .zip(&normals)
            .map(|(s, &normal)| normal * (4.0 * s * (1.0 - s)))
            .collect();
        let first = (joint - 1) * ENTRIES;
        let coefficients =
            Hinge { vertices, faces, shares: &shares, centre }
                .amplitude(joint, &bumps, |v| &directions[v][first..first + ENTRIES]);
        for (direction, &bump) in directions.iter_mut().zip(&bumps) {
            for (entry, coefficient) in coefficients.iter().enumerate() {
                direction[first + entry] += bump * *coefficient;
            }
        }
    }
}

/// Body at one joint.
struct Hinge<'a> {
    vertices: &'a [DVec3],
    faces: &'a [[u32; 3]],
    /// Share of each vertex's weights at the joint and below.
    shares: &'a [f64],
    centre: DVec3,
}

impl Hinge<'_> {
    /// Coefficients of the amplitude of `bumps`, metres per entry of `R − I`, beside the joint's present
    /// pose directions of a vertex.
    fn amplitude<'d>(
        &self,
        joint: usize,
        bumps: &[DVec3],
        directions: impl Fn(usize) -> &'d [DVec3],
    ) -> [f64; ENTRIES] {
        // Volumes are those of tetrahedra with their apex at the joint: faces that stay or turn as a
        // whole keep theirs.
        let blended = |v: u32| (1e-6..=1.0 - 1e-6).contains(&self.shares[v as usize]);
        let faces: Vec<[u32; 3]> =
            self.faces.iter().copied().filter(|face| face.iter().any(|&v| blended(v))).collect();
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        let rest: Vec<DVec3> = self.vertices.iter().map(|&p| p - self.centre).collect();
        let before: f64 = faces.iter().map(|face| triple(face.map(|v| rest[v as usize]))).sum();
        let mut posed = rest.clone();
        let mut moved = vec![DVec3::ZERO; rest.len()];
        let mut normal = [[0.0; ENTRIES]; ENTRIES];
        let mut right = [0.0; ENTRIES];
        for turn in samples(joint).into_iter().filter(|&turn| reaches(joint, turn)) {
            let rotation = rotation(turn);
            let features = entries(&rotation);
            for v in used.iter().map(|&v| v as usize) {
                let share = self.shares[v];
                let blend = |p: DVec3| p * (1.0 - share) + rotation * p * share;
                let correction: DVec3 =
                    directions(v).iter().zip(features).map(|(&d, f)| d * f).sum();
                posed[v] = blend(rest[v] + correction);
                moved[v] = blend(bumps[v]);
            }
            let (mut change, mut rate) = (-before, 0.0);
            for face in &faces {
                let [a, b, c] = face.map(|v| posed[v as usize]);
                let [u, v, w] = face.map(|v| moved[v as usize]);
                change += triple([a, b, c]);
                rate += u.dot(b.cross(c)) + v.dot(c.cross(a)) + w.dot(a.cross(b));
            }
            let row = features.map(|f| f * rate);
            for (i, a) in row.iter().enumerate() {
                right[i] -= a * change;
                normal[i].iter_mut().zip(&row).for_each(|(n, b)| *n += a * b);
                // The ridge bounds combinations of entries that rotations hardly vary.
                normal[i][i] += RIDGE * rate * rate;
            }
        }
        if normal[0][0] == 0.0 { right } else { solve(&cholesky(&normal), right) }
    }
}

/// True unless a rotation over-extends the joint. Volumes depend on the sense of a bend; coefficients
/// fitted to impossible rotations as well would fit the others less.
fn reaches(joint: usize, turn: DVec3) -> bool {
    let [knee, elbow, hip] = EXTENSION;
    match joint {
        1 | 2 => turn.x < hip,
        4 | 5 => turn.x > -knee,
        18 => turn.y < elbow,
        19 => turn.y > -elbow,
        _ => true,
    }
}

/// Six times the volume of the tetrahedron with its apex at the origin.
fn triple([a, b, c]: [DVec3; 3]) -> f64 {
    a.dot(b.cross(c))
}

/// Unit normals of the vertices, weighted by area.
fn vertex_normals(vertices: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        for &v in face {
            normals[v as usize] += (b - a).cross(c - a);
        }
    }
    normals.into_iter().map(DVec3::normalize_or_zero).collect()
}
