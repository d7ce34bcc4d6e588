//! Isosurfaces for garments.
//!
//! `cape-synth` has marching tetrahedra of its own: they follow the surface of a closed, mirrored
//! body from a seed on a refined grid. The simulation needs triangles of even size instead, which
//! surface nets give.

use std::collections::HashMap;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use cape_core::geometry::SurfaceMesh;

/// Zero surface of `field` in a box by naive surface nets (Gibson 1998) on cubes of `size` metres;
/// faces point to where the field is positive.
pub(super) fn surface_nets(
    low: DVec3,
    high: DVec3,
    size: f64,
    field: impl Fn(DVec3) -> f64 + Sync,
) -> SurfaceMesh {
    let count = ((high - low) / size).ceil().as_ivec3() + IVec3::ONE;
    let at = |node: IVec3| low + node.as_dvec3() * size;
    let index = |n: IVec3| ((n.x * count.y + n.y) * count.z + n.z) as usize;
    let values: Vec<f64> = (0..count.x * count.y * count.z)
        .into_par_iter()
        .map(|i| {
            let (z, rest) = (i % count.z, i / count.z);
            field(at(IVec3::new(rest / count.y, rest % count.y, z)))
        })
        .collect();
    let mut surface = SurfaceMesh::default();
    let mut of_cell: HashMap<IVec3, u32> = HashMap::new();
    let corner = |k: i32| IVec3::new(k & 1, k >> 1 & 1, k >> 2);
    for x in 0..count.x - 1 {
        for y in 0..count.y - 1 {
            for z in 0..count.z - 1 {
                let cell = IVec3::new(x, y, z);
                let (mut sum, mut crossings) = (DVec3::ZERO, 0.0);
                for k in 0..8 {
                    for axis in [1, 2, 4].into_iter().filter(|axis| k & axis == 0) {
                        let (p, q) = (cell + corner(k), cell + corner(k | axis));
                        let (a, b) = (values[index(p)], values[index(q)]);
                        if (a < 0.0) != (b < 0.0) {
                            sum += at(p).lerp(at(q), a / (a - b));
                            crossings += 1.0;
                        }
                    }
                }
                if crossings > 0.0 {
                    of_cell.insert(cell, surface.vertices.len() as u32);
                    surface.vertices.push(sum / crossings);
                }
            }
        }
    }
    for x in 1..count.x - 1 {
        for y in 1..count.y - 1 {
            for z in 1..count.z - 1 {
                let node = IVec3::new(x, y, z);
                for (axis, u, v) in [
                    (IVec3::X, IVec3::Y, IVec3::Z),
                    (IVec3::Y, IVec3::Z, IVec3::X),
                    (IVec3::Z, IVec3::X, IVec3::Y),
                ] {
                    let inside = values[index(node)] < 0.0;
                    if inside == (values[index(node + axis)] < 0.0) {
                        continue;
                    }
                    let around = [node - u - v, node - v, node, node - u];
                    let Some([a, b, c, d]) = quad(&of_cell, around) else { continue };
                    let [a, b, c, d] = if inside { [a, b, c, d] } else { [a, d, c, b] };
                    // Alternating diagonals avoid a preferred direction.
                    let even = (x + y + z) % 2 == 0;
                    surface.faces.extend(if even {
                        [[a, b, c], [a, c, d]]
                    } else {
                        [[a, b, d], [b, c, d]]
                    });
                }
            }
        }
    }
    surface
}

fn quad(of_cell: &HashMap<IVec3, u32>, cells: [IVec3; 4]) -> Option<[u32; 4]> {
    let [a, b, c, d] = cells.map(|cell| of_cell.get(&cell).copied());
    Some([a?, b?, c?, d?])
}
