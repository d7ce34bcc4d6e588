//! Grids and spheres.

use glam::DVec3;

use super::SurfaceMesh;

/// Grid of `n × m` vertices at `place(u, v)`, (u, v) in the unit square; diagonals alternate.
pub fn grid(n: usize, m: usize, place: impl Fn(f64, f64) -> DVec3) -> SurfaceMesh {
    let at = |i: usize, j: usize| (i * m + j) as u32;
    let mut surface = SurfaceMesh::default();
    for i in 0..n {
        for j in 0..m {
            let (u, v) = (i as f64 / (n - 1) as f64, j as f64 / (m - 1) as f64);
            surface.vertices.push(place(u, v));
        }
    }
    for i in 0..n - 1 {
        for j in 0..m - 1 {
            let [a, b, c, d] = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
            surface.faces.extend(if (i + j) % 2 == 0 {
                [[a, b, c], [a, c, d]]
            } else {
                [[a, b, d], [b, c, d]]
            });
        }
    }
    surface
}

/// Closed sphere around the origin, oriented outwards: an octahedron subdivided `splits` times.
pub fn sphere(radius: f64, splits: usize) -> SurfaceMesh {
    let mut vertices = vec![DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z];
    let mut faces: Vec<[u32; 3]> = vec![
        [0, 1, 2],
        [1, 3, 2],
        [3, 4, 2],
        [4, 0, 2],
        [1, 0, 5],
        [3, 1, 5],
        [4, 3, 5],
        [0, 4, 5],
    ];
    for _ in 0..splits {
        let mut middles = std::collections::HashMap::new();
        let mut middle = |p: u32, q: u32| {
            *middles.entry([p.min(q), p.max(q)]).or_insert_with(|| {
                vertices.push((vertices[p as usize] + vertices[q as usize]).normalize());
                vertices.len() as u32 - 1
            })
        };
        faces = faces
            .iter()
            .flat_map(|&[a, b, c]| {
                let [ab, bc, ca] = [middle(a, b), middle(b, c), middle(c, a)];
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    SurfaceMesh { vertices: vertices.into_iter().map(|v| v * radius).collect(), faces }
}
