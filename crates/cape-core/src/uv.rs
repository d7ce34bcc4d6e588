use std::collections::HashMap;

/// Texture coordinates of a mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Uv {
    /// Texture coordinates (u, v), origin at the bottom left, `[points, 2]`.
    pub coordinates: Vec<[f32; 2]>,
    /// Index into `coordinates` for each corner of each face, `[faces, 3]`.
    pub faces: Vec<[u32; 3]>,
}

impl Uv {
    /// The texture coordinates, which belong to the triangles `own`, for the triangles `faces` of the
    /// same mesh, which may be in another order, turned, or cut quadrilaterals along the other
    /// diagonal.
    ///
    /// ```
    /// use cape_core::obj::Uv;
    ///
    /// let uv = Uv { coordinates: vec![[0., 0.], [1., 0.], [1., 1.], [0., 1.]], faces: vec![[0, 1, 2], [0, 2, 3]] };
    /// // A quadrilateral of vertices 5 to 8, cut along 5–7 there and along 6–8 here.
    /// let found = uv.for_faces(&[[5, 6, 7], [5, 7, 8]], &[[6, 7, 8], [8, 5, 6]]).unwrap();
    /// assert_eq!(found.faces, [[1, 2, 3], [3, 0, 1]]);
    /// ```
    ///
    /// # Errors
    /// The index of the first of `faces` that is not a triangle of the mesh.
    pub fn for_faces(&self, own: &[[u32; 3]], faces: &[[u32; 3]]) -> Result<Self, usize> {
        if own == faces {
            return Ok(self.clone());
        }
        let lookup = Lookup::new(own, &self.faces);
        let found = faces.iter().enumerate();
        let found = found.map(|(index, &face)| lookup.points(face).ok_or(index));
        Ok(Self { coordinates: self.coordinates.clone(), faces: found.collect::<Result<_, _>>()? })
    }
}

/// Triangles with texture coordinates, by their corners and edges.
struct Lookup<'a> {
    own: &'a [[u32; 3]],
    points: &'a [[u32; 3]],
    by_corners: HashMap<[u32; 3], usize>,
    by_edge: HashMap<[u32; 2], Vec<usize>>,
}

impl<'a> Lookup<'a> {
    fn new(own: &'a [[u32; 3]], points: &'a [[u32; 3]]) -> Self {
        let mut by_corners = HashMap::new();
        let mut by_edge: HashMap<[u32; 2], Vec<usize>> = HashMap::new();
        for (index, &face) in own.iter().enumerate() {
            by_corners.entry(sorted(face)).or_insert(index);
            let [a, b, c] = face;
            for edge in [[a, b], [b, c], [c, a]] {
                by_edge.entry(sorted(edge)).or_default().push(index);
            }
        }
        Self { own, points, by_corners, by_edge }
    }

    /// Texture points of the corners of a triangle.
    fn points(&self, face: [u32; 3]) -> Option<[u32; 3]> {
        if let Some(&triangle) = self.by_corners.get(&sorted(face)) {
            let [a, b, c] = face.map(|vertex| self.point(triangle, vertex));
            return Some([a?, b?, c?]);
        }
        // Two triangles of a quadrilateral, which this one cuts along the other diagonal: they have the
        // middle corner in common, with one texture point.
        (0..3).find_map(|middle| {
            let [before, at, after] = [2, 0, 1].map(|step| face[(middle + step) % 3]);
            let pairs = self
                .edge(before, at)
                .iter()
                .flat_map(|first| self.edge(at, after).iter().map(move |second| (*first, *second)));
            for (first, second) in pairs.filter(|(first, second)| first != second) {
                let other = self.own[first].iter().find(|&&v| v != before && v != at)?;
                let shared = [at, *other].map(|vertex| {
                    self.point(first, vertex).filter(|&p| self.point(second, vertex) == Some(p))
                });
                if let [Some(point), Some(_)] = shared {
                    let mut points = [point; 3];
                    points[(middle + 2) % 3] = self.point(first, before)?;
                    points[(middle + 1) % 3] = self.point(second, after)?;
                    return Some(points);
                }
            }
            None
        })
    }

    fn edge(&self, a: u32, b: u32) -> &[usize] {
        self.by_edge.get(&sorted([a, b])).map_or(&[], Vec::as_slice)
    }

    /// Texture point of a vertex in a triangle.
    fn point(&self, triangle: usize, vertex: u32) -> Option<u32> {
        let corner = self.own[triangle].iter().position(|&corner| corner == vertex)?;
        self.points.get(triangle).map(|points| points[corner])
    }
}

fn sorted<const N: usize>(mut corners: [u32; N]) -> [u32; N] {
    corners.sort_unstable();
    corners
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A grid of 4 × 3 quadrilaterals with a seam in the middle, cut along one diagonal or the other.
    fn grid(other: bool) -> (Vec<[u32; 3]>, Uv) {
        let (mut faces, mut uv) = (Vec::new(), Uv::default());
        for index in 0..12u32 {
            let (x, y) = (index % 4, index / 4);
            let vertex = |dx: u32, dy: u32| (y + dy) * 5 + x + dx;
            // The two halves have texture points of their own.
            let point = |dx: u32, dy: u32| vertex(dx, dy) + if x < 2 { 0 } else { 100 };
            let corners = [(0, 0), (1, 0), (1, 1), (0, 1)];
            let cuts = if other { [[1, 2, 3], [3, 0, 1]] } else { [[0, 1, 2], [0, 2, 3]] };
            for cut in cuts {
                faces.push(cut.map(|k: usize| vertex(corners[k].0, corners[k].1)));
                uv.faces.push(cut.map(|k: usize| point(corners[k].0, corners[k].1)));
            }
        }
        uv.coordinates = (0..130).map(|k| [k as f32, 0.0]).collect();
        (faces, uv)
    }

    #[test]
    fn triangles_are_found_whatever_their_order() {
        let (own, uv) = grid(false);
        let turned: Vec<_> = own.iter().map(|&[a, b, c]| [b, c, a]).collect();
        let expected: Vec<_> = uv.faces.iter().map(|&[a, b, c]| [b, c, a]).collect();
        assert_eq!(uv.for_faces(&own, &turned).unwrap().faces, expected);
        let back: Vec<_> = own.iter().rev().copied().collect();
        let expected: Vec<_> = uv.faces.iter().rev().copied().collect();
        assert_eq!(uv.for_faces(&own, &back).unwrap().faces, expected);
        let (others, other_uv) = grid(true);
        assert_eq!(uv.for_faces(&own, &others).unwrap().faces, other_uv.faces);
        assert_eq!(other_uv.for_faces(&others, &own).unwrap().faces, uv.faces);
        assert_eq!(uv.for_faces(&own, &[own[0], [0, 1, 19]]), Err(1));
        // Across the seam there is no such triangle.
        assert_eq!(uv.for_faces(&own, &[[1, 8, 2]]), Err(0));
    }
}
