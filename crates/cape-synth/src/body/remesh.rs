//! Remeshing of the half surface to well-shaped triangles of prescribed size.
//!
//! The half surface lies in x ≥ 0 with one closed boundary curve in the plane x = 0; its mirror image
//! completes it. All operations keep the completed surface a manifold: besides the usual conditions,
//! only edges of the boundary curve may join two boundary vertices.

use glam::DVec3;

/// Triangle mesh with edge split, collapse and flip operations.
pub(super) struct EditableMesh<'a> {
    /// Vertex positions, metres; undefined for removed vertices.
    pub(super) position: Vec<DVec3>,
    face: Vec<[u32; 3]>,
    /// Faces of each vertex; empty for removed vertices.
    around: Vec<Vec<u32>>,
    /// Target edge length at each vertex.
    size: Vec<f64>,
    boundary: Vec<bool>,
    field: &'a dyn Fn(DVec3) -> f64,
}

/// Faces of an edge and their opposite corners.
struct Edge {
    faces: Vec<u32>,
    opposite: Vec<u32>,
}

impl<'a> EditableMesh<'a> {
    /// Creates the mesh; `field` is the target edge length up to a common factor.
    pub(super) fn new(
        position: Vec<DVec3>,
        face: Vec<[u32; 3]>,
        field: &'a dyn Fn(DVec3) -> f64,
    ) -> Self {
        let mut around = vec![Vec::new(); position.len()];
        for (index, corners) in face.iter().enumerate() {
            for &corner in corners {
                around[corner as usize].push(index as u32);
            }
        }
        let boundary = position.iter().map(|p| p.x == 0.0).collect();
        let size = position.iter().map(|&p| field(p)).collect();
        Self { position, face, around, size, boundary, field }
    }

    /// Number of vertices of the surface completed by its mirror image.
    pub(super) fn mirrored_count(&self) -> usize {
        (0..self.position.len())
            .filter(|&v| !self.around[v].is_empty())
            .map(|v| if self.boundary[v] { 1 } else { 2 })
            .sum()
    }

    /// Vertices and faces, renumbered without the removed ones.
    pub(super) fn finish(&self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let mut number = vec![u32::MAX; self.position.len()];
        let mut position = Vec::new();
        for v in (0..self.position.len()).filter(|&v| !self.around[v].is_empty()) {
            number[v] = position.len() as u32;
            position.push(self.position[v]);
        }
        let faces = self.live_faces().map(|f| f.map(|v| number[v as usize])).collect();
        (position, faces)
    }

    fn live_faces(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.face.iter().copied().filter(|f| f[0] != f[1])
    }

    /// All edges, each once, lower vertex index first.
    fn edges(&self) -> Vec<[u32; 2]> {
        let mut edges = Vec::with_capacity(self.face.len() * 3 / 2);
        for [a, b, c] in self.live_faces() {
            for (i, j) in [(a, b), (b, c), (c, a)] {
                let on_plane = self.boundary[i as usize] && self.boundary[j as usize];
                if i < j || on_plane {
                    edges.push([i.min(j), i.max(j)]);
                }
            }
        }
        edges
    }

    fn edge(&self, a: u32, b: u32) -> Edge {
        let mut edge = Edge { faces: Vec::with_capacity(2), opposite: Vec::with_capacity(2) };
        for &f in &self.around[a as usize] {
            let corners = self.face[f as usize];
            if corners.contains(&b) {
                edge.faces.push(f);
                edge.opposite.extend(corners.into_iter().filter(|&v| v != a && v != b));
            }
        }
        edge
    }

    fn neighbours(&self, v: u32) -> Vec<u32> {
        let mut found: Vec<u32> = Vec::with_capacity(8);
        for &f in &self.around[v as usize] {
            for corner in self.face[f as usize] {
                if corner != v && !found.contains(&corner) {
                    found.push(corner);
                }
            }
        }
        found
    }

    fn normal_with(&self, f: u32, moved: &[u32], to: DVec3) -> DVec3 {
        let [a, b, c] = self.face[f as usize]
            .map(|v| if moved.contains(&v) { to } else { self.position[v as usize] });
        (b - a).cross(c - a)
    }

    /// Length of edge `ab` relative to the target.
    fn relative_length(&self, [a, b]: [u32; 2]) -> f64 {
        let (a, b) = (a as usize, b as usize);
        self.position[a].distance(self.position[b]) * 2.0 / (self.size[a] + self.size[b])
    }

    fn split(&mut self, a: u32, b: u32) {
        let edge = self.edge(a, b);
        let middle = self.position.len() as u32;
        let (ia, ib) = (a as usize, b as usize);
        self.position.push((self.position[ia] + self.position[ib]) / 2.0);
        self.size.push(f64::midpoint(self.size[ia], self.size[ib]));
        self.boundary.push(edge.faces.len() == 1);
        self.around.push(edge.faces.clone());
        for (&f, &opposite) in edge.faces.iter().zip(&edge.opposite) {
            let second = self.face.len() as u32;
            let corners = self.face[f as usize];
            self.face.push(corners.map(|v| if v == a { middle } else { v }));
            self.face[f as usize] = corners.map(|v| if v == b { middle } else { v });
            self.around[ib].retain(|&g| g != f);
            self.around[ib].push(second);
            self.around[opposite as usize].push(second);
            self.around[middle as usize].push(second);
        }
    }

    /// Collapses edge `ab`, unless the surface would not stay a manifold or an edge would exceed
    /// `longest` times its target length. Returns true if it was collapsed.
    fn collapse(&mut self, a: u32, b: u32, longest: f64) -> bool {
        // `removed` merges into `kept`; a boundary vertex stays on the boundary.
        let (kept, removed) = if self.boundary[b as usize] { (b, a) } else { (a, b) };
        let edge = self.edge(kept, removed);
        let along = self.boundary[removed as usize];
        if along && edge.faces.len() != 1 {
            return false;
        }
        let (near_kept, near_removed) = (self.neighbours(kept), self.neighbours(removed));
        let common = near_kept.iter().filter(|v| near_removed.contains(v)).count();
        if common != edge.faces.len() {
            return false;
        }
        for &o in &edge.opposite {
            let least = if self.boundary[o as usize] { 2 } else { 3 };
            if self.around[o as usize].len() <= least {
                return false;
            }
        }
        let faces_left = self.around[kept as usize].len() + self.around[removed as usize].len();
        if faces_left < if along { 5 } else { 8 } {
            return false;
        }
        let on_plane = self.boundary[kept as usize];
        if on_plane && !along {
            let touches = near_removed
                .iter()
                .any(|&v| v != kept && self.boundary[v as usize] && !near_kept.contains(&v));
            if touches {
                return false;
            }
        }
        let to = if on_plane && !along {
            self.position[kept as usize]
        } else {
            (self.position[kept as usize] + self.position[removed as usize]) / 2.0
        };
        let size = self.size[kept as usize];
        for &v in near_kept.iter().chain(&near_removed) {
            let length = self.position[v as usize].distance(to) * 2.0;
            if v != kept && v != removed && length > longest * (size + self.size[v as usize]) {
                return false;
            }
        }
        let ends = [kept, removed];
        for end in ends {
            for &f in &self.around[end as usize] {
                if edge.faces.contains(&f) {
                    continue;
                }
                let before = self.normal_with(f, &[], to);
                let after = self.normal_with(f, &ends, to);
                if before.dot(after) <= 0.3 * before.length() * after.length() {
                    return false;
                }
            }
        }
        for (&f, &o) in edge.faces.iter().zip(&edge.opposite) {
            self.face[f as usize] = [u32::MAX; 3];
            self.around[o as usize].retain(|&g| g != f);
            self.around[kept as usize].retain(|&g| g != f);
        }
        for f in std::mem::take(&mut self.around[removed as usize]) {
            if edge.faces.contains(&f) {
                continue;
            }
            let corners = &mut self.face[f as usize];
            *corners = corners.map(|v| if v == removed { kept } else { v });
            self.around[kept as usize].push(f);
        }
        self.position[kept as usize] = to;
        self.size[kept as usize] = (self.field)(to);
        true
    }

    /// Valence of `v` in the completed surface, less the regular six.
    fn excess(&self, v: u32) -> i64 {
        let count = self.around[v as usize].len() as i64;
        if self.boundary[v as usize] { 2 * count - 6 } else { count - 6 }
    }

    /// Flips edge `ab` if valences get closer to six or, at equal valences, triangles better shaped.
    /// Returns true if it was flipped.
    fn flip(&mut self, a: u32, b: u32) -> bool {
        let edge = self.edge(a, b);
        let (&[f, g], &[c, d]) = (&edge.faces[..], &edge.opposite[..]) else { return false };
        if self.boundary[c as usize] && self.boundary[d as usize] {
            return false;
        }
        let scale = |v: u32| if self.boundary[v as usize] { 2 } else { 1 };
        let (ea, eb, ec, ed) = (self.excess(a), self.excess(b), self.excess(c), self.excess(d));
        let before = ea * ea + eb * eb + ec * ec + ed * ed;
        let (na, nb, nc, nd) = (ea - scale(a), eb - scale(b), ec + scale(c), ed + scale(d));
        let after = na * na + nb * nb + nc * nc + nd * nd;
        if na < -2 || nb < -2 || after > before {
            return false;
        }
        let p = |v: u32| self.position[v as usize];
        // Orient such that face f is (a, b, c).
        let corners = self.face[f as usize];
        let at = corners.iter().position(|&v| v == a).unwrap_or(0);
        let (a, b) = if corners[(at + 1) % 3] == b { (a, b) } else { (b, a) };
        let quality = |x, y, z| shape_quality(p(x), p(y), p(z));
        let old = quality(a, b, c).min(quality(b, a, d));
        let new = quality(a, d, c).min(quality(d, b, c));
        if (after == before && new <= old + 1e-3) || new < 0.5 * old.min(0.6) {
            return false;
        }
        let normal = (p(b) - p(a)).cross(p(c) - p(a)).normalize_or_zero()
            + (p(a) - p(b)).cross(p(d) - p(b)).normalize_or_zero();
        let first = (p(d) - p(a)).cross(p(c) - p(a)).normalize_or_zero();
        let second = (p(b) - p(d)).cross(p(c) - p(d)).normalize_or_zero();
        if first.dot(normal) < 0.5 || second.dot(normal) < 0.5 || first.dot(second) < 0.2 {
            return false;
        }
        if self.neighbours(c).contains(&d) {
            return false;
        }
        self.face[f as usize] = [a, d, c];
        self.face[g as usize] = [d, b, c];
        self.around[b as usize].retain(|&x| x != f);
        self.around[a as usize].retain(|&x| x != g);
        self.around[d as usize].push(f);
        self.around[c as usize].push(g);
        true
    }

    /// Collapses edges shorter than `shortest` times the target length, in passes until few remain.
    pub(super) fn coarsen(&mut self, scale: f64, shortest: f64) {
        for _ in 0..12 {
            let mut changed = 0;
            for [a, b] in self.edges() {
                let live = !self.around[a as usize].is_empty()
                    && !self.around[b as usize].is_empty()
                    && self.relative_length([a, b]) < shortest * scale
                    && !self.edge(a, b).faces.is_empty();
                if live && self.collapse(a, b, 1.45 * scale) {
                    changed += 1;
                }
            }
            if changed * 200 < self.face.len() {
                return;
            }
        }
    }

    /// Splits edges longer than `longest` times the target length.
    pub(super) fn refine(&mut self, scale: f64, longest: f64) {
        for [a, b] in self.edges() {
            if self.relative_length([a, b]) > longest * scale {
                self.split(a, b);
            }
        }
    }

    /// Flips edges towards regular valences.
    pub(super) fn regularise(&mut self) {
        for _ in 0..3 {
            let mut changed = false;
            for [a, b] in self.edges() {
                changed |= self.flip(a, b);
            }
            if !changed {
                return;
            }
        }
    }

    /// Tangential smoothing: moves each vertex by `step` towards the mean of its neighbours within the
    /// tangent plane, then onto the surface by `project`.
    pub(super) fn relax(&mut self, step: f64, project: &dyn Fn(DVec3) -> DVec3) {
        let moved: Vec<DVec3> = (0..self.position.len() as u32)
            .map(|v| self.relaxed(v, step).map_or(self.position[v as usize], project))
            .collect();
        for (v, mut p) in moved.into_iter().enumerate() {
            if self.boundary[v] {
                p.x = 0.0;
            } else {
                p.x = p.x.max(1e-3);
            }
            self.position[v] = p;
            self.size[v] = (self.field)(p);
        }
    }

    fn relaxed(&self, v: u32, step: f64) -> Option<DVec3> {
        let faces = &self.around[v as usize];
        if faces.is_empty() {
            return None;
        }
        let here = self.position[v as usize];
        let on_plane = self.boundary[v as usize];
        let mut normal = DVec3::ZERO;
        let mut sum = DVec3::ZERO;
        let mut weight = 0.0;
        for &f in faces {
            let corners = self.face[f as usize];
            let [a, b, c] = corners.map(|u| self.position[u as usize]);
            let area = (b - a).cross(c - a);
            normal += area;
            let size: f64 = corners.iter().map(|&u| self.size[u as usize]).sum::<f64>() / 3.0;
            let w = area.length() / (size * size);
            sum += (a + b + c) / 3.0 * w;
            weight += w;
        }
        let mut towards = sum / weight.max(f64::MIN_POSITIVE) - here;
        if on_plane {
            normal.x = 0.0;
            towards.x = 0.0;
        }
        let normal = normal.normalize_or_zero();
        Some(here + (towards - normal * towards.dot(normal)) * step)
    }

    /// Splits the longest or collapses the shortest edges until the completed surface has exactly
    /// `count` vertices. Returns false if no permitted operation remains.
    pub(super) fn settle(&mut self, count: usize) -> bool {
        while self.mirrored_count() != count {
            let now = self.mirrored_count();
            let odd = now % 2 != count % 2;
            let mut edges: Vec<(f64, [u32; 2])> = self
                .edges()
                .into_iter()
                .filter(|&[a, b]| {
                    let [p, q] = [self.boundary[a as usize], self.boundary[b as usize]];
                    if odd { p && q } else { !p && !q }
                })
                .map(|e| (self.relative_length(e), e))
                .collect();
            edges.sort_by(|x, y| x.0.total_cmp(&y.0).then(x.1.cmp(&y.1)));
            if odd || now < count {
                let Some(&(_, [a, b])) = edges.last() else { return false };
                self.split(a, b);
            } else if !edges.iter().any(|&(_, [a, b])| self.collapse(a, b, f64::INFINITY)) {
                return false;
            }
        }
        true
    }
}

/// Shape quality of a triangle, 4√3 · area / Σ edge²: 1 equilateral, 0 degenerate.
pub(super) fn shape_quality(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let area = (b - a).cross(c - a).length();
    let edges = (b - a).length_squared() + (c - b).length_squared() + (a - c).length_squared();
    2.0 * 3.0_f64.sqrt() * area / edges.max(f64::MIN_POSITIVE)
}
