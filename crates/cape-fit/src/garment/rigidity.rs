//! The energy of Sorkine and Alexa (2007) that keeps a mesh as rigid as possible, and the linear system of
//! its step with fixed rotations and correspondences.

use glam::{DMat3, DVec3};

use crate::scan::rigid::RigidTransform;
use cape_core::geometry::SurfaceMesh;

/// Weight of an edge for each of its faces: half the cotangent of 60°. Equal weights suit garments, whose
/// triangles are nearly equilateral, and are positive for all others.
const COTANGENT: f64 = 0.288_675;

/// Most iterations of conjugate gradients.
const ITERATIONS: usize = 200;

/// Relative residual at which the iterations end.
const RESIDUAL: f64 = 1e-4;

/// A mesh whose neighbourhoods of vertices resist everything but rotation.
#[derive(Debug, Clone)]
pub(super) struct RigidMesh {
    rest: Vec<DVec3>,
    edges: Vec<[u32; 2]>,
    weights: Vec<f64>,
    /// Edges of each vertex.
    around: Vec<Vec<u32>>,
    /// Edges of each face: from its first corner to its second, second to third, third to first.
    sides: Vec<[u32; 3]>,
}

/// A symmetric system `A x = b` with the blocks of a mesh's vertices and edges.
#[derive(Debug, Clone)]
pub(super) struct MeshSystem {
    diagonal: Vec<DMat3>,
    /// Symmetric blocks, `[edges]`.
    across: Vec<DMat3>,
    right: Vec<DVec3>,
}

impl MeshSystem {
    /// Adds `(Σ b_i x_i − to)ᵀ M (Σ b_i x_i − to)` for a point with the barycentric coordinates `b` on a
    /// face and the symmetric `metric` M.
    pub(super) fn pull(
        &mut self,
        (corners, sides): ([u32; 3], Option<[u32; 3]>),
        barycentric: [f64; 3],
        (to, metric): (DVec3, DMat3),
    ) {
        for (&v, b) in corners.iter().zip(barycentric) {
            self.diagonal[v as usize] += metric * (b * b);
            self.right[v as usize] += metric * to * b;
        }
        let Some(sides) = sides else { return };
        for (side, edge) in sides.into_iter().enumerate() {
            let (p, q) = (barycentric[side], barycentric[(side + 1) % 3]);
            self.across[edge as usize] += metric * (p * q);
        }
    }
}

impl RigidMesh {
    pub(super) fn new(rest: &SurfaceMesh) -> Self {
        let edges = rest.edges();
        let place = |a: u32, b: u32| edges.binary_search(&[a.min(b), a.max(b)]).unwrap_or_default();
        let side = |[a, b, c]: [u32; 3]| [place(a, b), place(b, c), place(c, a)].map(|e| e as u32);
        let sides: Vec<[u32; 3]> = rest.faces.iter().map(|&face| side(face)).collect();
        let mut weights = vec![0.0; edges.len()];
        sides.iter().flatten().for_each(|&edge| weights[edge as usize] += COTANGENT);
        let mut around = vec![Vec::new(); rest.vertices.len()];
        for (edge, ends) in edges.iter().enumerate() {
            for &v in ends {
                around[v as usize].push(edge as u32);
            }
        }
        Self { rest: rest.vertices.clone(), edges, weights, around, sides }
    }

    /// Rotation of each vertex's edges from the rest shape to the positions `at`.
    pub(super) fn rotations(&self, at: &[DVec3]) -> Vec<DMat3> {
        let rotation = |v: usize| {
            // The edges and their opposites, whose mean is zero.
            let pairs: Vec<(DVec3, DVec3, f64)> = self.around[v]
                .iter()
                .flat_map(|&edge| {
                    let [a, b] = self.edges[edge as usize].map(|v| v as usize);
                    let (was, now) = (self.rest[b] - self.rest[a], at[b] - at[a]);
                    let weight = self.weights[edge as usize];
                    [(was, now, weight), (-was, -now, weight)]
                })
                .collect();
            RigidTransform::between(&pairs).map_or(DMat3::IDENTITY, |rigid| rigid.rotation)
        };
        (0..self.rest.len()).map(rotation).collect()
    }

    /// System of the minimum of `λ Σ_v Σ_e w_e ‖(x_b − x_a) − R_v (p_b − p_a)‖²` over the edges `e = ab` of
    /// all vertices `v`.
    pub(super) fn system(&self, rotations: &[DMat3], rigidity: f64) -> MeshSystem {
        let mut system = MeshSystem {
            diagonal: vec![DMat3::ZERO; self.rest.len()],
            across: Vec::with_capacity(self.edges.len()),
            right: vec![DVec3::ZERO; self.rest.len()],
        };
        for (ends, weight) in self.edges.iter().zip(&self.weights) {
            let [a, b] = ends.map(|v| v as usize);
            let weight = rigidity * weight;
            let own = DMat3::from_diagonal(DVec3::splat(2.0 * weight));
            system.diagonal[a] += own;
            system.diagonal[b] += own;
            system.across.push(-own);
            let pull = (rotations[a] + rotations[b]) * (self.rest[b] - self.rest[a]) * weight;
            system.right[a] -= pull;
            system.right[b] += pull;
        }
        system
    }

    /// Edges of a face.
    pub(super) fn sides(&self, face: usize) -> [u32; 3] {
        self.sides[face]
    }

    /// Solves a system by conjugate gradients with the diagonal's blocks as preconditioner, from the
    /// positions `x`.
    pub(super) fn solve(&self, system: &MeshSystem, x: &mut [DVec3]) {
        // Vertices of no face, which nothing moves, have no block.
        let invert = |block: &DMat3| {
            if block.determinant() > 0.0 { block.inverse() } else { DMat3::ZERO }
        };
        let inverse: Vec<DMat3> = system.diagonal.iter().map(invert).collect();
        let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
        let product = |x: &[DVec3]| {
            let mut image: Vec<DVec3> =
                system.diagonal.iter().zip(x).map(|(block, &x)| *block * x).collect();
            for (ends, block) in self.edges.iter().zip(&system.across) {
                let [a, b] = ends.map(|v| v as usize);
                image[a] += *block * x[b];
                image[b] += *block * x[a];
            }
            image
        };
        let image = product(x);
        let mut residual: Vec<DVec3> =
            system.right.iter().zip(image).map(|(right, image)| *right - image).collect();
        let scale = |residual: &[DVec3]| -> Vec<DVec3> {
            inverse.iter().zip(residual).map(|(inverse, &r)| *inverse * r).collect()
        };
        let enough = RESIDUAL * RESIDUAL * dot(&system.right, &scale(&system.right));
        let mut direction = scale(&residual);
        let mut energy = dot(&residual, &direction);
        for _ in 0..ITERATIONS {
            if energy <= enough {
                break;
            }
            let image = product(&direction);
            let curvature = dot(&direction, &image);
            if curvature <= 0.0 || curvature.is_nan() {
                break;
            }
            let step = energy / curvature;
            for v in 0..x.len() {
                x[v] += direction[v] * step;
                residual[v] -= image[v] * step;
            }
            let scaled = scale(&residual);
            let next = dot(&residual, &scaled);
            for (direction, scaled) in direction.iter_mut().zip(scaled) {
                *direction = scaled + *direction * (next / energy);
            }
            energy = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;
    use cape_core::geometry::primitives::grid;

    fn sheet() -> SurfaceMesh {
        grid(7, 9, |u, v| DVec3::new(0.3 * u, 0.4 * v, 0.02 * (7.0 * u).sin()))
    }

    #[test]
    fn rotated_and_moved_meshes_are_at_rest() {
        let rest = sheet();
        let turn = DQuat::from_euler(glam::EulerRot::XYZ, 0.4, -1.1, 2.0);
        let at: Vec<DVec3> = rest.vertices.iter().map(|&x| turn * x + DVec3::X).collect();
        let mesh = RigidMesh::new(&rest);
        let rotations = mesh.rotations(&at);
        for found in &rotations {
            assert!((DMat3::from_quat(turn) - *found).col(0).length() < 1e-9);
        }
        // One vertex that is held decides where all the others are.
        let mut system = mesh.system(&rotations, 1.0);
        let hold = (at[0], DMat3::IDENTITY);
        system.pull(([0; 3], None), [1.0, 0.0, 0.0], hold);
        let mut x = rest.vertices.clone();
        mesh.solve(&system, &mut x);
        for (x, at) in x.iter().zip(&at) {
            assert!(x.distance(*at) < 1e-3, "{x} {at}");
        }
    }

    #[test]
    fn vertices_of_no_face_stay_and_do_not_hold_the_others() {
        let mut rest = sheet();
        rest.vertices.push(DVec3::splat(3.0));
        let mesh = RigidMesh::new(&rest);
        let mut system = mesh.system(&mesh.rotations(&rest.vertices), 1.0);
        let to = rest.vertices[0] + DVec3::Y;
        system.pull(([0; 3], None), [1.0, 0.0, 0.0], (to, DMat3::IDENTITY));
        let mut x = rest.vertices.clone();
        mesh.solve(&system, &mut x);
        assert_eq!(x.last(), rest.vertices.last());
        assert!(x[1].distance(rest.vertices[1] + DVec3::Y) < 1e-3, "{}", x[1]);
    }

    #[test]
    fn points_pull_by_their_barycentric_coordinates() {
        // The gradient of the energy of one point vanishes at the solution of the system.
        let rest = sheet();
        let mesh = RigidMesh::new(&rest);
        let rotations = mesh.rotations(&rest.vertices);
        let (face, barycentric) = (20, [0.5, 0.3, 0.2]);
        let normal = DVec3::new(0.6, 0.0, 0.8);
        let metric = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z)
            + DMat3::IDENTITY * 0.1;
        let to = rest.vertices[rest.faces[face][0] as usize] + DVec3::new(0.02, 0.01, 0.05);
        let mut system = mesh.system(&rotations, 0.3);
        let on = (rest.faces[face], Some(mesh.sides(face)));
        system.pull(on, barycentric, (to, metric));
        let corner = (rest.vertices[0], DMat3::IDENTITY);
        system.pull(([0; 3], None), [1.0, 0.0, 0.0], corner);
        let mut x = rest.vertices.clone();
        mesh.solve(&system, &mut x);
        let energy = |x: &[DVec3]| {
            let mut sum = (x[0] - corner.0).length_squared();
            let at: DVec3 =
                rest.faces[face].iter().zip(barycentric).map(|(&v, b)| x[v as usize] * b).sum();
            sum += (at - to).dot(metric * (at - to));
            for (ends, weight) in mesh.edges.iter().zip(&mesh.weights) {
                let [a, b] = ends.map(|v| v as usize);
                let off = (x[b] - x[a]) - (rest.vertices[b] - rest.vertices[a]);
                sum += 2.0 * 0.3 * weight * off.length_squared();
            }
            sum
        };
        assert!(energy(&x) < energy(&rest.vertices));
        for v in rest.faces[face] {
            for axis in 0..3 {
                let moved = |by: f64| {
                    let mut moved = x.clone();
                    moved[v as usize][axis] += by;
                    energy(&moved)
                };
                let slope = (moved(1e-5) - moved(-1e-5)) / 2e-5;
                assert!(slope.abs() < 1e-4, "{v} {axis}: {slope}");
            }
        }
    }
}
