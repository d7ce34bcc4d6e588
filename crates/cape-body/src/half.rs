//! The left half of the base mesh as triangles with texture coordinates.

use std::collections::HashMap;

use glam::DVec3;

use crate::{
    Error, Result,
    assets::{BaseMesh, SKIN},
};

/// Triangle of the half with the texture coordinates of its corners and of their mirror images.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Triangle {
    pub(crate) corners: [u32; 3],
    pub(crate) uv: [[u32; 2]; 3],
}

/// Triangles of the half x ≥ 0; each quadrilateral is cut along its shorter diagonal on `vertices`.
pub(crate) fn left_half(base: &BaseMesh, vertices: &[DVec3]) -> Result<Vec<Triangle>> {
    let key = |quad: &[u32; 4]| {
        let mut key = *quad;
        key.sort_unstable();
        key
    };
    let by_corners: HashMap<[u32; 4], usize> =
        base.quads.iter().enumerate().map(|(i, quad)| (key(quad), i)).collect();
    let mut triangles = Vec::with_capacity(base.quads.len());
    for (quad, uv) in base.quads.iter().zip(&base.quad_uv) {
        let x: f64 = quad.iter().map(|&v| base.vertices[v as usize].x).sum();
        if x <= 0.0 {
            continue;
        }
        let image = quad.map(|v| base.mirror[v as usize]);
        let &other = by_corners
            .get(&key(&image))
            .ok_or_else(|| Error::argument("base mesh: a face without a mirror image"))?;
        let uv_of = |v: u32| {
            let at = base.quads[other].iter().position(|&corner| corner == v).unwrap_or(0);
            base.quad_uv[other][at]
        };
        let pairs: [[u32; 2]; 4] = std::array::from_fn(|i| [uv[i], uv_of(image[i])]);
        let span = |a: usize, b: usize| {
            vertices[quad[a] as usize].distance_squared(vertices[quad[b] as usize])
        };
        let cuts =
            if span(0, 2) <= span(1, 3) { [[0, 1, 2], [0, 2, 3]] } else { [[0, 1, 3], [1, 2, 3]] };
        triangles.extend(cuts.map(|cut| Triangle {
            corners: cut.map(|i: usize| quad[i]),
            uv: cut.map(|i: usize| pairs[i]),
        }));
    }
    Ok(triangles)
}

/// Adjacent vertices of each vertex of the body, along the sides of the quadrilaterals.
pub(crate) fn neighbours(quads: &[[u32; 4]]) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::new(); SKIN];
    for &[a, b, c, d] in quads {
        for (from, to) in [(a, b), (b, c), (c, d), (d, a)] {
            around[from as usize].push(to);
        }
    }
    around
}
