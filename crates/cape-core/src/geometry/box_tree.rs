use glam::DVec3;
use parry3d_f64::{
    bounding_volume::Aabb,
    math::Vector,
    partitioning::{Bvh, BvhBuildStrategy, BvhNode},
    query::{PointQuery, Ray},
};

/// A bounding-volume hierarchy over axis-aligned boxes, one for each element of a surface: its faces,
/// edges or points, numbered from 0.
///
/// The exact distance to an element is the caller's: the tree finds the elements to measure.
///
/// ```
/// use cape_core::geometry::BoxTree;
/// use glam::DVec3;
///
/// // Three points on a line, 1 m apart.
/// let points: Vec<DVec3> = (0..3).map(|x| DVec3::X * f64::from(x)).collect();
/// let tree = BoxTree::from_elements(&[[0], [1], [2]], &points);
/// let query = DVec3::new(1.2, 0.5, 0.0);
/// let distance = |element: u32| Some(points[element as usize].distance(query));
/// assert_eq!(tree.nearest(query, 1.0, distance).map(|found| found.0), Some(1));
/// assert!(tree.nearest(query, 0.1, distance).is_none());
/// let near: Vec<u32> = tree.overlapping([DVec3::splat(-0.1), DVec3::splat(0.1)]);
/// assert_eq!(near, [0]);
/// ```
#[derive(Debug, Clone)]
pub struct BoxTree(Bvh);

impl BoxTree {
    /// A hierarchy over boxes, each by its lowest and highest corner, metres.
    pub fn new(boxes: impl IntoIterator<Item = [DVec3; 2]>) -> Self {
        let boxes = boxes.into_iter().enumerate().map(|(index, ends)| (index, aabb(ends)));
        Self(Bvh::from_iter(BvhBuildStrategy::Binned, boxes))
    }

    /// A hierarchy over elements of `N` vertices each, by vertex index; `vertices` in metres.
    pub fn from_elements<const N: usize>(elements: &[[u32; N]], vertices: &[DVec3]) -> Self {
        Self::new(elements.iter().map(|element| bounds(element.map(|v| vertices[v as usize]))))
    }

    /// The element nearest to `point` and its distance, metres, among those closer than `reach`.
    /// `distance` measures an element; `None` leaves it out.
    pub fn nearest(
        &self,
        point: DVec3,
        reach: f64,
        distance: impl Fn(u32) -> Option<f64>,
    ) -> Option<(u32, f64)> {
        let from = vector(point);
        self.0.find_best(
            reach,
            |node: &BvhNode, _| node.aabb().distance_to_local_point(from, true),
            |element, _| distance(element),
        )
    }

    /// The first element that a ray (unit `direction`) meets within `reach` metres, and the length of
    /// the ray up to it. `distance` intersects the ray with an element.
    pub fn cast(
        &self,
        origin: DVec3,
        direction: DVec3,
        reach: f64,
        distance: impl Fn(u32) -> Option<f64>,
    ) -> Option<(u32, f64)> {
        let ray = Ray::new(vector(origin), vector(direction));
        self.0.cast_ray(&ray, reach, |element, _| distance(element))
    }

    /// Elements whose boxes overlap a box, by its lowest and highest corner.
    pub fn overlapping(&self, ends: [DVec3; 2]) -> Vec<u32> {
        self.0.intersect_aabb(&aabb(ends)).collect()
    }
}

/// Lowest and highest corner of the axis-aligned box around points.
pub fn bounds(points: impl IntoIterator<Item = DVec3>) -> [DVec3; 2] {
    points.into_iter().fold([DVec3::INFINITY, DVec3::NEG_INFINITY], |[low, high], point| {
        [low.min(point), high.max(point)]
    })
}

fn aabb([low, high]: [DVec3; 2]) -> Aabb {
    Aabb::new(vector(low), vector(high))
}

fn vector(point: DVec3) -> Vector {
    Vector::from(point.to_array())
}
