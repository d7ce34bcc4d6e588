//! A mesh for benchmarks.

use cape::core::Mesh;

/// A slightly uneven torus of `rings · sides` vertices.
pub(crate) fn torus(rings: u32, sides: u32) -> Mesh {
    let angle = |i: u32, n: u32| i as f32 / n as f32 * std::f32::consts::TAU;
    let mut mesh = Mesh::default();
    for ring in 0..rings {
        for side in 0..sides {
            let (u, v) = (angle(ring, rings), angle(side, sides));
            let radius = 0.5 + 0.2 * v.cos() + 0.01 * (3.0 * u + v).sin();
            mesh.vertices.push([radius * u.cos(), 0.2 * v.sin(), radius * u.sin()]);
            let at = |r: u32, s: u32| (r % rings) * sides + s % sides;
            let (a, b) = (at(ring, side), at(ring, side + 1));
            let (c, d) = (at(ring + 1, side), at(ring + 1, side + 1));
            mesh.faces.extend([[a, b, c], [b, d, c]]);
        }
    }
    mesh
}
