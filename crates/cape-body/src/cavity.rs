//! Closing of mouth, eye sockets and nostrils by membranes.

use std::f64::consts::PI;

use glam::DVec3;

use crate::{
    Result,
    assets::{BaseMesh, SKIN},
};
use cape_core::geometry::{SurfaceIndex, SurfaceMesh};

/// Number of directions in which a vertex looks.
const RAYS: usize = 256;
/// Share of free directions below which a vertex lies in a cavity.
const OPEN: f64 = 0.08;
/// Smallest cavity that is closed, vertices.
const SMALLEST: usize = 12;
/// Relaxation steps of the membranes.
const STEPS: usize = 400;

/// Vertices in cavities, and eyeballs that show through.
pub(crate) struct Cavities {
    inside: Vec<u32>,
    around: Vec<Vec<u32>>,
    eyes: [Vec<u32>; 2],
}

impl Cavities {
    /// Finds the vertices of the head from which nearly no ray escapes, on `vertices` in metres;
    /// eyeballs block rays.
    pub(crate) fn find(
        base: &BaseMesh,
        vertices: &[DVec3],
        head: impl Fn(usize) -> bool,
        around: &[Vec<u32>],
    ) -> Result<Self> {
        let split = |&[a, b, c, d]: &[u32; 4]| [[a, b, c], [a, c, d]];
        let faces = base.quads.iter().chain(&base.eyes).flat_map(split).collect();
        let surface = SurfaceMesh::new("base mesh", vertices.to_vec(), faces)?;
        let normals = surface.vertex_normals();
        let index = SurfaceIndex::new(&surface);
        let mut hidden = vec![false; SKIN];
        for v in (0..SKIN).filter(|&v| head(v) && vertices[v].x >= 0.0) {
            let origin = vertices[v] + normals[v] * 1e-4;
            let free = directions(RAYS).filter(|&d| index.cast(origin, d, 0.5).is_none()).count();
            hidden[v] = (free as f64) < OPEN * RAYS as f64;
            hidden[base.mirror[v] as usize] = hidden[v];
        }
        let mut inside = Vec::new();
        let mut seen = vec![false; SKIN];
        for start in 0..SKIN {
            if !hidden[start] || seen[start] {
                continue;
            }
            let mut component = vec![start as u32];
            seen[start] = true;
            let mut next = 0;
            while next < component.len() {
                for &n in &around[component[next] as usize] {
                    if hidden[n as usize] && !std::mem::replace(&mut seen[n as usize], true) {
                        component.push(n);
                    }
                }
                next += 1;
            }
            if component.len() >= SMALLEST {
                inside.extend(component);
            }
        }
        inside.sort_unstable();
        let around = inside.iter().map(|&v| around[v as usize].clone()).collect();
        let eye = |side: &str| base.groups.get(side).cloned().unwrap_or_default();
        Ok(Self { inside, around, eyes: [eye("helper-l-eye"), eye("helper-r-eye")] })
    }

    /// Spans membranes over the cavities; those over the eyes bulge to the eyeballs.
    pub(crate) fn close(&self, vertices: &mut [DVec3]) {
        let balls = self.eyes.each_ref().map(|eye| ball(vertices, eye));
        for _ in 0..STEPS {
            for (&v, near) in self.inside.iter().zip(&self.around) {
                let sum: DVec3 = near.iter().map(|&n| vertices[n as usize]).sum();
                vertices[v as usize] = sum / near.len() as f64;
            }
        }
        for &v in &self.inside {
            let p = &mut vertices[v as usize];
            for (centre, radius) in balls {
                let offset = *p - centre;
                if offset.length() < radius && offset.z > 0.0 {
                    *p = centre + offset.normalize_or(DVec3::Z) * radius;
                }
            }
        }
    }
}

/// Centre and median radius of an eyeball.
fn ball(vertices: &[DVec3], eye: &[u32]) -> (DVec3, f64) {
    let points = || eye.iter().map(|&v| vertices[v as usize]);
    let bounds =
        points().fold((DVec3::MAX, DVec3::MIN), |(low, high), p| (low.min(p), high.max(p)));
    let centre = (bounds.0 + bounds.1) * 0.5;
    let mut radii: Vec<f64> = points().map(|p| p.distance(centre)).collect();
    radii.sort_by(f64::total_cmp);
    (centre, radii.get(radii.len() / 2).copied().unwrap_or(0.0))
}

/// Evenly distributed unit vectors (a Fibonacci lattice).
pub(crate) fn directions(count: usize) -> impl Iterator<Item = DVec3> {
    (0..count).map(move |i| {
        let z = 1.0 - (2.0 * i as f64 + 1.0) / count as f64;
        let angle = i as f64 * PI * (3.0 - 5.0_f64.sqrt());
        let radius = (1.0 - z * z).sqrt();
        DVec3::new(radius * angle.cos(), radius * angle.sin(), z)
    })
}
