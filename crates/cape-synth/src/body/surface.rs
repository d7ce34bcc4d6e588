//! Mesh of 6890 vertices of the body's signed distance field.

use glam::DVec3;

use super::{
    VERTICES, figure,
    polygonise::{Grid, polygonise},
    remesh::EditableMesh,
    sdf::BodySdf,
};

/// Closed mesh, symmetric in x = 0.
pub(super) struct SymmetricMesh {
    /// Vertex positions, metres, `[6890]`.
    pub(super) vertices: Vec<DVec3>,
    /// Triangles, oriented outwards, `[13776]`.
    pub(super) faces: Vec<[u32; 3]>,
    /// Index of the mirror image of each vertex, `[6890]`.
    pub(super) mirror: Vec<u32>,
}

/// Symmetric mesh of the zero surface of `sdf`.
pub(super) fn symmetric_mesh(sdf: &BodySdf) -> SymmetricMesh {
    let (position, face) = half(sdf);
    mirrored(&position, &face)
}

/// Vertices and triangles of the half surface in x ≥ 0.
fn half(sdf: &BodySdf) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let grid = Grid::new(
        DVec3::new(0.0, -1.2, -0.18),
        DVec3::new(0.90, 0.60, 0.20),
        0.007,
        0.0035,
        [[0.68, 0.90], [0.18, 0.25], [-0.11, 0.06]],
    );
    let inside = DVec3::new(0.0, 0.3, 0.0);
    let (position, face) = polygonise(&grid, |p| sdf.distance(p), inside);
    let mut surface = EditableMesh::new(position, face, &figure::edge_size);
    let mut scale = 0.0206;
    surface.coarsen(0.5 * scale, 0.8);
    surface.relax(0.5, &|p| sdf.project(p, 1));
    surface.coarsen(scale, 0.75);
    for _ in 0..ROUNDS {
        surface.refine(scale, 1.36);
        surface.coarsen(scale, 0.74);
        surface.regularise();
        surface.relax(0.6, &|p| sdf.project(p, 1));
        surface.relax(0.6, &|p| sdf.project(p, 1));
        scale *= (surface.mirrored_count() as f64 / VERTICES as f64).sqrt();
    }
    let settled = surface.settle(VERTICES);
    debug_assert!(settled, "the vertex count of the body is constant and tested");
    for _ in 0..8 {
        surface.regularise();
        surface.relax(0.6, &|p| sdf.project(p, 1));
    }
    surface.relax(0.3, &|p| sdf.project(p, 3));
    surface.finish()
}

/// Rounds of remeshing until convergence.
const ROUNDS: usize = 10;

/// Joins the half surface with its mirror image; vertices are numbered in rings from the top of the
/// head, so that neighbours are close in memory.
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

/// Vertex indices in breadth-first order from the highest vertex.
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

/// Adjacent vertices of each vertex of a closed, oriented mesh.
pub(super) fn neighbours(vertices: usize, faces: &[[u32; 3]]) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::with_capacity(8); vertices];
    for &[a, b, c] in faces {
        for (from, to) in [(a, b), (b, c), (c, a)] {
            around[from as usize].push(to);
        }
    }
    around
}

/// Area-weighted unit normals of the vertices.
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
