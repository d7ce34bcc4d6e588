//! Quadric edge collapse of the half mesh, which stands for collapses in mirrored pairs.
//!
//! A collapse keeps one of its vertices, so that shapes of the fine mesh give those of the coarse one.
//! Vertices of the midline move only along it, vertices of a texture seam only along the seam.

use std::{
    cmp::{Ordering, Reverse},
    collections::BinaryHeap,
};

use glam::{DMat3, DVec3};

use crate::{Error, Result, half::Triangle};

/// Weight of the squared edge length beside the squared distance from planes.
const LENGTH: f64 = 0.004;
/// Factor on the cost of vertices of the midline: their quadrics lack the mirrored faces, and their
/// collapse removes one vertex of the whole body, not two.
const MIDLINE: f64 = 4.0;
/// Smallest cosine between a face's normals before and after a collapse.
const TURN: f64 = 0.4;
/// Smallest shape of a face, 1 for an equilateral one, that a collapse may make.
const SHAPE: f64 = 0.25;
/// Most faces at a vertex.
const VALENCE: usize = 9;

/// Squared distance to planes, weighted by area: `xᵀA x + 2 b·x + c`.
#[derive(Debug, Clone, Copy)]
struct Quadric {
    a: DMat3,
    b: DVec3,
    c: f64,
    area: f64,
}

impl Quadric {
    const ZERO: Self = Self { a: DMat3::ZERO, b: DVec3::ZERO, c: 0.0, area: 0.0 };

    fn of_plane(normal: DVec3, point: DVec3, area: f64) -> Self {
        let offset = -normal.dot(point);
        let a = DMat3::from_cols(normal * normal.x, normal * normal.y, normal * normal.z);
        Self { a: a * area, b: normal * offset * area, c: offset * offset * area, area }
    }

    fn plus(self, other: Self) -> Self {
        Self {
            a: self.a + other.a,
            b: self.b + other.b,
            c: self.c + other.c,
            area: self.area + other.area,
        }
    }

    fn at(&self, x: DVec3) -> f64 {
        x.dot(self.a * x) + 2.0 * self.b.dot(x) + self.c
    }
}

/// Candidate of the queue; the stamps tell if it is still current.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Candidate {
    cost: f64,
    removed: u32,
    kept: u32,
    stamps: [u32; 2],
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        let key = |c: &Self| (c.removed, c.kept, c.stamps);
        self.cost.total_cmp(&other.cost).then_with(|| key(self).cmp(&key(other)))
    }
}

/// Collapses edges until the half and its mirror image have `target` vertices. `importance` scales the
/// cost of removing a vertex.
pub(crate) fn collapse(
    triangles: Vec<Triangle>,
    vertices: &[DVec3],
    midline: &[bool],
    importance: &[f64],
    target: usize,
) -> Result<Vec<Triangle>> {
    let mut mesh = Collapsing::new(triangles, vertices, midline, importance);
    let mut queue = BinaryHeap::new();
    for v in 0..vertices.len() as u32 {
        mesh.push_edges(v, &mut queue);
    }
    let mut count = mesh.whole_count();
    while count > target {
        let Some(Reverse(best)) = queue.pop() else { break };
        let [removed, kept] = [best.removed, best.kept];
        let single = midline[removed as usize];
        let step = if single { 1 } else { 2 };
        if best.stamps != mesh.stamps(removed, kept) || count - step < target {
            continue;
        }
        let Some(uv) = mesh.permitted(removed, kept) else { continue };
        mesh.remove(removed, kept, &uv);
        count -= step;
        let touched: Vec<u32> = mesh.neighbours(kept);
        mesh.stamp[kept as usize] += 1;
        for &v in &touched {
            mesh.stamp[v as usize] += 1;
        }
        mesh.push_edges(kept, &mut queue);
        for &v in &touched {
            mesh.push_edges(v, &mut queue);
        }
    }
    if count != target {
        return Err(Error::argument(format!(
            "base mesh: simplified to {count} vertices, expected {target}"
        )));
    }
    Ok(mesh.triangles.into_iter().flatten().collect())
}

struct Collapsing<'a> {
    triangles: Vec<Option<Triangle>>,
    around: Vec<Vec<u32>>,
    vertices: &'a [DVec3],
    midline: &'a [bool],
    importance: &'a [f64],
    quadrics: Vec<Quadric>,
    stamp: Vec<u32>,
}

impl<'a> Collapsing<'a> {
    fn new(
        triangles: Vec<Triangle>,
        vertices: &'a [DVec3],
        midline: &'a [bool],
        importance: &'a [f64],
    ) -> Self {
        let mut around = vec![Vec::new(); vertices.len()];
        let mut quadrics = vec![Quadric::ZERO; vertices.len()];
        for (index, triangle) in triangles.iter().enumerate() {
            let [a, b, c] = triangle.corners.map(|v| vertices[v as usize]);
            let normal = (b - a).cross(c - a);
            let quadric = Quadric::of_plane(normal.normalize_or_zero(), a, normal.length() / 6.0);
            for v in triangle.corners {
                around[v as usize].push(index as u32);
                quadrics[v as usize] = quadrics[v as usize].plus(quadric);
            }
        }
        Self {
            triangles: triangles.into_iter().map(Some).collect(),
            around,
            vertices,
            midline,
            importance,
            quadrics,
            stamp: vec![0; vertices.len()],
        }
    }

    /// Vertices of the half and its mirror image.
    fn whole_count(&self) -> usize {
        let used = (0..self.around.len()).filter(|&v| !self.around[v].is_empty());
        used.map(|v| if self.midline[v] { 1 } else { 2 }).sum()
    }

    fn stamps(&self, a: u32, b: u32) -> [u32; 2] {
        [a, b].map(|v| self.stamp[v as usize])
    }

    fn at(&self, v: u32) -> DVec3 {
        self.vertices[v as usize]
    }

    fn faces(&self, v: u32) -> impl Iterator<Item = Triangle> + '_ {
        self.around[v as usize].iter().filter_map(|&f| self.triangles[f as usize])
    }

    fn neighbours(&self, v: u32) -> Vec<u32> {
        let mut found: Vec<u32> =
            self.faces(v).flat_map(|f| f.corners).filter(|&corner| corner != v).collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    fn push_edges(&self, v: u32, queue: &mut BinaryHeap<Reverse<Candidate>>) {
        for n in self.neighbours(v) {
            for (removed, kept) in [(v, n), (n, v)] {
                if self.midline[removed as usize] && !self.midline[kept as usize] {
                    continue;
                }
                let quadric = self.quadrics[removed as usize];
                let sum = quadric.plus(self.quadrics[kept as usize]);
                let length = self.at(removed).distance_squared(self.at(kept));
                let cost = sum.at(self.at(kept)).max(0.0) + LENGTH * length * quadric.area;
                let profile = if self.midline[removed as usize] { MIDLINE } else { 1.0 };
                let cost = cost * self.importance[removed as usize] * profile;
                let stamps = self.stamps(removed, kept);
                queue.push(Reverse(Candidate { cost, removed, kept, stamps }));
            }
        }
    }

    /// Texture coordinates that replace those of `removed`, on both sides; `None` if the collapse would
    /// break the surface, the midline or a seam, or turn a face over.
    fn permitted(&self, removed: u32, kept: u32) -> Option<[Vec<(u32, u32)>; 2]> {
        let (near, far) = (self.neighbours(removed), self.neighbours(kept));
        let common = near.iter().filter(|v| far.contains(v)).count();
        let edge_faces: Vec<Triangle> =
            self.faces(removed).filter(|f| f.corners.contains(&kept)).collect();
        let on_midline = |v: u32| self.midline[v as usize];
        // An inner edge between two midline vertices would be doubled by its mirror image.
        let along_midline = on_midline(removed) && on_midline(kept);
        let expected = if along_midline { 1 } else { 2 };
        if edge_faces.len() != expected || common != expected {
            return None;
        }
        let bridged = |&v: &u32| v != kept && on_midline(v) && !far.contains(&v);
        if !on_midline(removed) && on_midline(kept) && near.iter().any(bridged) {
            return None;
        }
        if self.around[kept as usize].len() + self.around[removed as usize].len()
            > VALENCE + 2 * expected
        {
            return None;
        }
        let thin =
            |&v: &u32| far.contains(&v) && !on_midline(v) && self.around[v as usize].len() <= 4;
        if near.iter().any(thin) {
            return None;
        }
        let mut uv = [Vec::new(), Vec::new()];
        for face in &edge_faces {
            let corner = |v: u32| face.corners.iter().position(|&c| c == v);
            let (from, to) = (corner(removed)?, corner(kept)?);
            for (side, pairs) in uv.iter_mut().enumerate() {
                pairs.push((face.uv[from][side], face.uv[to][side]));
            }
        }
        for pairs in &uv {
            // A seam along which only one of the two ends is cut.
            if pairs.len() == 2 && pairs[0].0 == pairs[1].0 && pairs[0].1 != pairs[1].1 {
                return None;
            }
        }
        for face in self.faces(removed).filter(|f| !f.corners.contains(&kept)) {
            let at = face.corners.iter().position(|&c| c == removed)?;
            let mapped = (0..2).all(|side| uv[side].iter().any(|pair| pair.0 == face.uv[at][side]));
            let before = face.corners.map(|v| self.at(v));
            let after = face.corners.map(|v| self.at(if v == removed { kept } else { v }));
            let (old, new) = (normal(before), normal(after));
            let turned = new.dot(old) < TURN * new.length() * old.length();
            let shaped = shape(after) >= SHAPE.min(0.9 * shape(before));
            if !mapped || turned || !shaped || new.length() < 1e-12 {
                return None;
            }
        }
        Some(uv)
    }

    fn remove(&mut self, removed: u32, kept: u32, uv: &[Vec<(u32, u32)>; 2]) {
        self.quadrics[kept as usize] =
            self.quadrics[kept as usize].plus(self.quadrics[removed as usize]);
        for index in std::mem::take(&mut self.around[removed as usize]) {
            let Some(face) = &mut self.triangles[index as usize] else { continue };
            if face.corners.contains(&kept) {
                let corners = face.corners;
                self.triangles[index as usize] = None;
                for v in corners {
                    self.around[v as usize].retain(|&f| f != index);
                }
                continue;
            }
            for (corner, at) in face.corners.iter_mut().zip(&mut face.uv) {
                if *corner == removed {
                    *corner = kept;
                    for side in 0..2 {
                        let pair = uv[side].iter().find(|pair| pair.0 == at[side]);
                        at[side] = pair.map_or(at[side], |pair| pair.1);
                    }
                }
            }
            self.around[kept as usize].push(index);
        }
    }
}

fn normal([a, b, c]: [DVec3; 3]) -> DVec3 {
    (b - a).cross(c - a)
}

/// Shape of a triangle: 1 if equilateral, 0 if degenerate.
fn shape(corners: [DVec3; 3]) -> f64 {
    let [a, b, c] = corners;
    let squares = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    2.0 * 3.0_f64.sqrt() * normal(corners).length() / squares.max(f64::MIN_POSITIVE)
}
