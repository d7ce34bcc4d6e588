use cape_core::geometry::{BoxTree, closest_on_triangle, face_normals};
use glam::DVec3;

use crate::silhouette::SurfacePoint;

/// The point of a surface that is nearest to another.
#[derive(Debug, Clone, Copy)]
pub(crate) struct NearestPoint {
    /// The point by face and barycentric weights.
    pub(crate) on: SurfacePoint,
    /// Position, metres.
    pub(crate) at: DVec3,
}

/// Triangles, or a cloud of points, in a bounding-volume hierarchy, with a normal for each that
/// [`nearest`](Self::nearest) can be restricted by.
///
/// [`SurfaceIndex`](cape_core::geometry::SurfaceIndex) signs distances by pseudo-normals and needs a
/// surface of faces; scans may have none, and have normals of their own that may be reversed.
#[derive(Debug, Clone)]
pub(crate) struct SurfaceTree<'a> {
    vertices: &'a [DVec3],
    faces: &'a [[u32; 3]],
    /// Unit normals of the faces, or of the points where there are no faces; empty if unknown.
    normals: Vec<DVec3>,
    boxes: BoxTree,
}

impl<'a> SurfaceTree<'a> {
    /// A tree of triangles; `faces` must be valid indices into `vertices`.
    pub(crate) fn from_faces(vertices: &'a [DVec3], faces: &'a [[u32; 3]]) -> Self {
        let boxes = BoxTree::from_elements(faces, vertices);
        Self { vertices, faces, normals: face_normals(vertices, faces), boxes }
    }

    /// A tree of points; `normals` has one for each point, or is empty.
    pub(crate) fn from_points(vertices: &'a [DVec3], normals: Vec<DVec3>) -> Self {
        let boxes = BoxTree::new(vertices.iter().map(|&at| [at; 2]));
        Self { vertices, faces: &[], normals, boxes }
    }

    /// Reverses all normals.
    pub(crate) fn flip(&mut self) {
        self.normals.iter_mut().for_each(|normal| *normal = -*normal);
    }

    /// Drops all normals.
    pub(crate) fn forget_normals(&mut self) {
        self.normals.clear();
    }

    /// Unit normal of a face or point; zero if unknown.
    pub(crate) fn normal(&self, element: usize) -> DVec3 {
        self.normals.get(element).copied().unwrap_or_default()
    }

    /// The face or point nearest to `point` and the nearest point on it, among those closer than
    /// `reach` metres whose normal does not face away from `normal`; a zero `normal` allows all.
    pub(crate) fn nearest(
        &self,
        point: DVec3,
        normal: DVec3,
        reach: f64,
    ) -> Option<(usize, NearestPoint)> {
        let (element, _) = self.boxes.nearest(point, reach, |element| {
            let element = element as usize;
            let same_side = self.normal(element).dot(normal) >= 0.0;
            same_side.then(|| self.on(element, point).at.distance(point))
        })?;
        Some((element as usize, self.on(element as usize, point)))
    }

    fn on(&self, element: usize, point: DVec3) -> NearestPoint {
        let Some(&corners) = self.faces.get(element) else {
            let corner = element as u32;
            let on = SurfacePoint { corners: [corner; 3], weights: [1.0, 0.0, 0.0] };
            return NearestPoint { on, at: self.vertices[element] };
        };
        let (_, weights) =
            closest_on_triangle(point, corners.map(|corner| self.vertices[corner as usize]));
        let on = SurfacePoint { corners, weights };
        NearestPoint { on, at: on.at(self.vertices) }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Least distance from a point to a grid of 200 steps on a triangle.
    fn brute(point: DVec3, [a, b, c]: [DVec3; 3]) -> f64 {
        const STEPS: usize = 200;
        let mut least = f64::INFINITY;
        for i in 0..=STEPS {
            for j in 0..=STEPS - i {
                let (u, v) = (i as f64 / STEPS as f64, j as f64 / STEPS as f64);
                least = least.min(point.distance(a + (b - a) * u + (c - a) * v));
            }
        }
        least
    }

    fn points(numbers: &[f64]) -> Vec<DVec3> {
        numbers.as_chunks::<3>().0.iter().map(|&p| DVec3::from_array(p)).collect()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn the_nearest_is_what_brute_force_finds(
            numbers in prop::collection::vec(-1.0f64..1.0, 27),
            x in -2.0f64..2.0, y in -2.0f64..2.0, z in -2.0f64..2.0,
        ) {
            let vertices = points(&numbers);
            let faces = [[0u32, 1, 2], [3, 4, 5], [6, 7, 8]];
            let point = DVec3::new(x, y, z);
            let tree = SurfaceTree::from_faces(&vertices, &faces);
            let (element, found) = tree.nearest(point, DVec3::ZERO, 100.0).unwrap();
            let all = faces.map(|face| brute(point, face.map(|corner| vertices[corner as usize])));
            let least = all.iter().copied().fold(f64::INFINITY, f64::min);
            let distance = found.at.distance(point);
            prop_assert!(distance <= least + 1e-9 && distance > least - 0.02, "{distance} {least}");
            prop_assert!(all[element] < least + 0.02);
            prop_assert!(found.on.at(&vertices).distance(found.at) < 1e-12);

            let cloud = SurfaceTree::from_points(&vertices, Vec::new());
            let (index, found) = cloud.nearest(point, DVec3::ZERO, 100.0).unwrap();
            let least = vertices.iter().map(|v| v.distance(point)).fold(f64::INFINITY, f64::min);
            prop_assert_eq!(found.at.distance(point), least);
            prop_assert_eq!(vertices[index], found.at);
            prop_assert!(cloud.nearest(point, DVec3::ZERO, least).is_none());
        }
    }

    #[test]
    fn the_far_side_is_not_the_nearest() {
        // The two sides of a plate; the nearer one faces away.
        let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
        let vertices =
            [0.0, 0.1].map(|z| [corner(-1.0, -1.0, z), corner(1.0, -1.0, z), corner(0.0, 2.0, z)]);
        let faces = [[0, 2, 1], [3, 4, 5]];
        let tree = SurfaceTree::from_faces(vertices.as_flattened(), &faces);
        let point = DVec3::new(0.0, 0.0, -0.1);
        let face = |normal| tree.nearest(point, normal, 1.0).unwrap().0;
        assert_eq!((face(DVec3::ZERO), face(DVec3::NEG_Z), face(DVec3::Z)), (0, 0, 1));
    }
}
