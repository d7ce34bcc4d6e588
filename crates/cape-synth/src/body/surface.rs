//! From the implicit figure to its mesh of 6890 vertices.

use glam::DVec3;

use super::{
    VERTICES, figure,
    polygonise::{Grid, polygonise},
    remesh::EditableMesh,
    sdf::BodySdf,
};

/// A closed mesh that is its own mirror image in x = 0.
pub(super) struct SymmetricMesh {
    /// Positions, `[6890]`.
    pub(super) vertices: Vec<DVec3>,
    /// Outward-oriented triangles, `[13776]`.
    pub(super) faces: Vec<[u32; 3]>,
    /// The mirror image of each vertex; itself in the plane x = 0.
    pub(super) mirror: Vec<u32>,
}

/// The mesh of `figure`'s sculpture.
pub(super) fn symmetric_mesh(sculpture: &BodySdf) -> SymmetricMesh {
    let (position, face) = half(sculpture);
    mirrored(&position, &face)
}

fn half(sculpture: &BodySdf) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let grid = Grid::new(
        DVec3::new(0.0, -1.2, -0.18),
        DVec3::new(0.90, 0.60, 0.20),
        0.007,
        0.0035,
        [[0.68, 0.90], [0.18, 0.25], [-0.11, 0.06]],
    );
    let inside = DVec3::new(0.0, 0.3, 0.0);
    let (position, face) = polygonise(&grid, |p| sculpture.distance(p), inside);
    let mut surface = EditableMesh::new(position, face, &figure::edge_size);
    let mut scale = 0.0206;
    surface.coarsen(0.5 * scale, 0.8);
    surface.relax(0.5, &|p| sculpture.project(p, 1));
    surface.coarsen(scale, 0.75);
    for _ in 0..ROUNDS {
        surface.refine(scale, 1.36);
        surface.coarsen(scale, 0.74);
        surface.regularise();
        surface.relax(0.6, &|p| sculpture.project(p, 1));
        surface.relax(0.6, &|p| sculpture.project(p, 1));
        scale *= (surface.mirrored_count() as f64 / VERTICES as f64).sqrt();
    }
    let settled = surface.settle(VERTICES);
    debug_assert!(settled, "the figure is the same on every call, and its count is tested");
    for _ in 0..8 {
        surface.regularise();
        surface.relax(0.6, &|p| sculpture.project(p, 1));
    }
    surface.relax(0.3, &|p| sculpture.project(p, 3));
    surface.finish()
}

/// Rounds of remeshing; the mesh hardly changes after them.
const ROUNDS: usize = 10;

/// The half surface with its mirror image, numbered outwards in rings from the top of the head so
/// that neighbours are near each other in memory.
fn mirrored(position: &[DVec3], face: &[[u32; 3]]) -> SymmetricMesh {
    let mut image = Vec::with_capacity(position.len());
    let mut vertices = position.to_vec();
    for (v, p) in position.iter().enumerate() {
        if p.x == 0.0 {
            image.push(v as u32);
        } else {
            image.push(vertices.len() as u32);
            vertices.push(DVec3::new(-p.x, p.y, p.z));
        }
    }
    let faces: Vec<[u32; 3]> = face
        .iter()
        .flat_map(|&[a, b, c]| {
            [[a, b, c], [image[a as usize], image[c as usize], image[b as usize]]]
        })
        .collect();
    let mut mirror = image.clone();
    mirror.resize(vertices.len(), 0);
    for (v, &m) in image.iter().enumerate() {
        mirror[m as usize] = v as u32;
    }

    let order = rings(&vertices, &faces);
    let mut number = vec![0; order.len()];
    for (new, &old) in order.iter().enumerate() {
        number[old as usize] = new as u32;
    }
    let mut faces: Vec<[u32; 3]> = faces
        .iter()
        .map(|f| {
            let f = f.map(|v| number[v as usize]);
            let first = (0..3).min_by_key(|&i| f[i]).unwrap_or(0);
            [f[first], f[(first + 1) % 3], f[(first + 2) % 3]]
        })
        .collect();
    faces.sort_unstable();
    SymmetricMesh {
        vertices: order.iter().map(|&v| vertices[v as usize]).collect(),
        faces,
        mirror: order.iter().map(|&v| number[mirror[v as usize] as usize]).collect(),
    }
}

/// Vertices in breadth-first order from the highest one.
fn rings(vertices: &[DVec3], faces: &[[u32; 3]]) -> Vec<u32> {
    let around = neighbours(vertices.len(), faces);
    let top = (0..vertices.len()).max_by(|&a, &b| vertices[a].y.total_cmp(&vertices[b].y));
    let mut order: Vec<u32> = top.map(|v| v as u32).into_iter().collect();
    let mut seen = vec![false; vertices.len()];
    for &v in &order {
        seen[v as usize] = true;
    }
    let mut next = 0;
    while next < order.len() {
        for &n in &around[order[next] as usize] {
            if !std::mem::replace(&mut seen[n as usize], true) {
                order.push(n);
            }
        }
        next += 1;
    }
    order
}

/// The vertices adjacent to each vertex of a closed, oriented mesh.
pub(super) fn neighbours(vertices: usize, faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::with_capacity(8); vertices];
    for &[a, b, c] in faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            around[from as usize].push(to);
        }
    }
    around
}

/// Unit vertex normals (area-weighted).
pub(super) fn normals(vertices: &[DVec3], faces: &[[u32; 3]]) -> Vec<DVec3> {
    let mut normals = vec![DVec3::ZERO; vertices.len()];
    for face in faces {
        let [a, b, c] = face.map(|v| vertices[v as usize]);
        let area = (b - a).cross(c - a);
        for &v in face {
            normals[v as usize] += area;
        }
    }
    normals.iter().map(|n| n.normalize_or_zero()).collect()
}
