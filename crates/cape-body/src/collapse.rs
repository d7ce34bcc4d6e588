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
/// Smallest shape of a face that replaces a worse one.
const SLIVER: f64 = 0.15;
/// Twice the area of a face whose direction is not kept, m².
const SPECK: f64 = 2e-7;
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

/// Collapses edges until the half and its mirror image have `target` vertices. Costs are those of the
/// first of `forms`, which are vertices of one body each; no collapse may turn over or distort a face of
/// any. `importance` scales the cost of removing a vertex.
pub(crate) fn collapse(
    triangles: Vec<Triangle>,
    forms: &[Vec<DVec3>],
    midline: &[bool],
    importance: &[f64],
    target: usize,
) -> Result<Vec<Triangle>> {
    let mut mesh = Collapsing::new(triangles, forms, midline, importance);
    let mut queue = BinaryHeap::new();
    for v in 0..midline.len() as u32 {
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
    /// Vertices of each form.
    forms: &'a [Vec<DVec3>],
    midline: &'a [bool],
    importance: &'a [f64],
    quadrics: Vec<Quadric>,
    stamp: Vec<u32>,
}

impl<'a> Collapsing<'a> {
    fn new(
        triangles: Vec<Triangle>,
        forms: &'a [Vec<DVec3>],
        midline: &'a [bool],
        importance: &'a [f64],
    ) -> Self {
        let vertices = &forms[0];
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
            forms,
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
        self.forms[0][v as usize]
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
            if !mapped {
                return None;
            }
        }
        self.forms.iter().all(|form| self.keeps_shape(form, removed, kept)).then_some(uv)
    }

    /// True if the collapse neither turns over nor distorts a face of `form`.
    fn keeps_shape(&self, form: &[DVec3], removed: u32, kept: u32) -> bool {
        let corners = |face: Triangle| face.corners.map(|v| form[v as usize]);
        // Slivers may be replaced by better slivers.
        let worst = self.faces(removed).map(|face| shape(corners(face))).fold(1.0, f64::min);
        self.faces(removed).filter(|face| !face.corners.contains(&kept)).all(|face| {
            let before = corners(face);
            let after =
                face.corners.map(|v| form[if v == removed { kept as usize } else { v as usize }]);
            let (old, new) = (normal(before), normal(after));
            let turned = old.length() > SPECK && new.dot(old) < TURN * new.length() * old.length();
            let distorted = shape(after) < SHAPE.min(0.9 * shape(before)).min(worst.max(SLIVER));
            !turned && !distorted && new.length() >= 1e-12
        })
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

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;

    const RINGS: u32 = 20;
    const SECTORS: u32 = 24;

    /// Half x ≥ 0 of a unit sphere about the y axis: vertices, midline, triangles.
    fn half_sphere() -> (Vec<DVec3>, Vec<bool>, Vec<Triangle>) {
        let mut vertices = vec![DVec3::NEG_Y, DVec3::Y];
        let mut midline = vec![true, true];
        let at = |ring: u32, sector: u32| 2 + (ring - 1) * (SECTORS + 1) + sector;
        for ring in 1..RINGS {
            let height = std::f64::consts::PI * f64::from(ring) / f64::from(RINGS);
            for sector in 0..=SECTORS {
                let turn = std::f64::consts::PI * f64::from(sector) / f64::from(SECTORS);
                let middle = sector == 0 || sector == SECTORS;
                let x = if middle { 0.0 } else { height.sin() * turn.sin() };
                vertices.push(DVec3::new(x, -height.cos(), height.sin() * turn.cos()));
                midline.push(middle);
            }
        }
        let mut corners = Vec::new();
        for sector in 0..SECTORS {
            corners.push([0, at(1, sector + 1), at(1, sector)]);
            corners.push([1, at(RINGS - 1, sector), at(RINGS - 1, sector + 1)]);
            for ring in 1..RINGS - 1 {
                let [a, b] = [at(ring, sector), at(ring, sector + 1)];
                let [c, d] = [at(ring + 1, sector), at(ring + 1, sector + 1)];
                corners.extend([[a, b, c], [b, d, c]]);
            }
        }
        let triangle = |corners: [u32; 3]| Triangle { corners, uv: corners.map(|v| [v, v]) };
        (vertices, midline, corners.into_iter().map(triangle).collect())
    }

    #[test]
    fn a_half_sphere_stays_closed_with_its_mirror_image_and_near_the_sphere() {
        let (vertices, midline, triangles) = half_sphere();
        let importance = vec![1.0; vertices.len()];
        let target = 400;
        let forms =
            [vertices.clone(), vertices.iter().map(|&p| p * DVec3::new(1.0, 2.0, 0.5)).collect()];
        let left = collapse(triangles, &forms, &midline, &importance, target).unwrap();
        // The mirror image of vertex v is v on the midline and v + n elsewhere.
        let n = vertices.len() as u32;
        let image = |v: u32| if midline[v as usize] { v } else { v + n };
        let faces = left.iter().map(|t| t.corners);
        let faces: Vec<[u32; 3]> =
            faces.clone().chain(faces.map(|[a, b, c]| [a, c, b].map(image))).collect();
        let mut edges: HashMap<(u32, u32), usize> = HashMap::new();
        for &[a, b, c] in &faces {
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_default() += 1;
            }
        }
        assert!(edges.iter().all(|(&(a, b), &count)| count == 1 && edges.contains_key(&(b, a))));
        let mut used: Vec<u32> = faces.iter().flatten().copied().collect();
        used.sort_unstable();
        used.dedup();
        assert_eq!(used.len(), target);
        assert_eq!(used.len() + faces.len(), edges.len() / 2 + 2);
        for triangle in &left {
            let [a, b, c] = triangle.corners.map(|v| vertices[v as usize]);
            assert!(((a + b + c) / 3.0).length() > 0.95);
            assert!(normal([a, b, c]).dot(a + b + c) > 0.0);
            assert_eq!(triangle.uv, triangle.corners.map(|v| [v, v]));
        }
    }

    #[test]
    fn too_few_vertices_are_an_error() {
        let (vertices, midline, triangles) = half_sphere();
        let importance = vec![1.0; vertices.len()];
        assert!(collapse(triangles, &[vertices], &midline, &importance, 4).is_err());
    }
}
