use std::collections::HashMap;

use glam::DVec3;
use rayon::prelude::*;

use cape_core::geometry::SurfaceMesh;

/// Largest connected part of the faces with a corner where `margin`, metres, exceeds `least`. Each of
/// these faces has such a corner, so that moving the boundary to where the margin is zero ([`fair`])
/// collapses none.
pub(super) fn cut(surface: &SurfaceMesh, margin: impl Fn(DVec3) -> f64, least: f64) -> SurfaceMesh {
    let inside: Vec<bool> = surface.vertices.iter().map(|&p| margin(p) > least).collect();
    let any = |face: &&[u32; 3]| face.iter().any(|&v| inside[v as usize]);
    let faces: Vec<[u32; 3]> = surface.faces.iter().filter(any).copied().collect();
    let mut root: Vec<u32> = (0..surface.vertices.len() as u32).collect();
    for face in &faces {
        let [a, b, c] = face.map(|v| find(&mut root, v));
        let least = a.min(b).min(c);
        for v in [a, b, c] {
            root[v as usize] = least;
        }
    }
    let mut sizes: HashMap<u32, usize> = HashMap::new();
    for face in &faces {
        *sizes.entry(find(&mut root, face[0])).or_default() += 1;
    }
    let largest = sizes.into_iter().max_by_key(|&(part, size)| (size, std::cmp::Reverse(part)));
    let Some((largest, _)) = largest else { return SurfaceMesh::default() };
    let mut place: HashMap<u32, u32> = HashMap::new();
    let mut out = SurfaceMesh::default();
    for face in faces.into_iter().filter(|face| find(&mut root, face[0]) == largest) {
        out.faces.push(face.map(|v| {
            *place.entry(v).or_insert_with(|| {
                out.vertices.push(surface.vertices[v as usize]);
                out.vertices.len() as u32 - 1
            })
        }));
    }
    out
}

/// Root of the connected part of `v`, with path halving.
fn find(root: &mut [u32], mut v: u32) -> u32 {
    while root[v as usize] != v {
        root[v as usize] = root[root[v as usize] as usize];
        v = root[v as usize];
    }
    v
}

/// Iterations of [`fair`] that project all vertices to the surface, then those that project only
/// vertices inside it.
const ROUNDS: [usize; 2] = [20, 12];

/// Smooths the triangles of a garment on the zero surface of `field`, then stretches it over concave
/// parts such as armpits. Vertices of the boundary stay on the curve where `margin` is zero as well.
/// Both functions are approximate signed distances, metres.
pub(super) fn fair(
    surface: &mut SurfaceMesh,
    field: impl Fn(DVec3) -> f64 + Sync,
    margin: impl Fn(DVec3) -> f64 + Sync,
) {
    let boundary = surface.boundary();
    let mut around = vec![Vec::new(); surface.vertices.len()];
    for (corners, across) in surface.faces.iter().zip(surface.neighbours()) {
        for side in 0..3 {
            let (p, q) = (corners[side], corners[(side + 1) % 3]);
            // Boundary vertices are smoothed along the boundary only.
            let on_boundary = across[side].is_none();
            for (from, to) in [(p, q), (q, p)] {
                if !boundary[from as usize] || on_boundary {
                    around[from as usize].push(to);
                }
            }
        }
    }
    for round in 0..ROUNDS[0] + ROUNDS[1] {
        let back = round < ROUNDS[0];
        let before = &surface.vertices;
        surface.vertices = (0..before.len())
            .into_par_iter()
            .map(|v| {
                let sum: DVec3 = around[v].iter().map(|&n| before[n as usize]).sum();
                let mut p = before[v].lerp(sum / around[v].len().max(1) as f64, 0.5);
                for _ in 0..2 {
                    if boundary[v] {
                        p = onto(&margin, p);
                    }
                    if back || field(p) < 0.0 {
                        p = onto(&field, p);
                    }
                }
                p
            })
            .collect();
    }
}

/// One Newton step towards the zero surface of a function.
fn onto(function: &impl Fn(DVec3) -> f64, p: DVec3) -> DVec3 {
    const STEP: f64 = 1e-4;
    let at = function(p);
    let slope = DVec3::AXES.map(|axis| (function(p + axis * STEP) - at) / STEP);
    let slope = DVec3::from_array(slope);
    // On the medial axis the gradient vanishes.
    p - slope * (at / slope.length_squared().max(0.25))
}
