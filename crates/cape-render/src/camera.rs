use cape_core::Mesh;
use glam::{
    Mat4, Vec3,
    camera::rh::{proj::directx, view},
};

/// Camera projection.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Projection {
    /// Perspective projection with a vertical field of view, radians.
    Perspective(f32),
    /// Orthographic projection.
    Orthographic,
}

impl Default for Projection {
    fn default() -> Self {
        Self::Perspective(0.42)
    }
}

/// Direction from which the camera sees a body that faces +z.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum View {
    /// Front view.
    Front,
    /// Half-way between the front and the body's left side.
    ThreeQuarter,
    /// View of the body's left side, from +x.
    Side,
    /// Back view.
    Back,
    /// Half-way between the back and the body's right side.
    BackThreeQuarter,
}

impl View {
    /// Azimuth around y, radians: 0 in front, positive towards the body's left.
    pub const fn azimuth(self) -> f32 {
        use std::f32::consts::PI;
        match self {
            Self::Front => 0.0,
            Self::ThreeQuarter => 0.22 * PI,
            Self::Side => 0.5 * PI,
            Self::Back => PI,
            Self::BackThreeQuarter => 1.22 * PI,
        }
    }
}

/// Axis-aligned bounding box, metres.
///
/// ```
/// use cape_render::Bounds;
///
/// let bounds = Bounds::from_points(&[[0., 0., 0.], [2., 4., 4.], [1., f32::NAN, 9.]]).unwrap();
/// assert_eq!(bounds.centre().to_array(), [1., 2., 2.]);
/// assert_eq!(bounds.radius(), 3.0);
/// assert!(Bounds::from_points(&[]).is_none());
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bounds {
    /// Smallest coordinates.
    pub min: Vec3,
    /// Largest coordinates.
    pub max: Vec3,
}

impl Bounds {
    /// Bounding box of the finite `points`; `None` without any.
    pub fn from_points<'a>(points: impl IntoIterator<Item = &'a [f32; 3]>) -> Option<Self> {
        let mut points = points.into_iter().map(|&p| Vec3::from(p)).filter(|p| p.is_finite());
        let first = points.next()?;
        Some(points.fold(Self { min: first, max: first }, |bounds, p| Self {
            min: bounds.min.min(p),
            max: bounds.max.max(p),
        }))
    }

    /// Bounding box of the vertices of `meshes`; `None` without any.
    pub fn from_meshes<'a>(meshes: impl IntoIterator<Item = &'a Mesh>) -> Option<Self> {
        Self::from_points(meshes.into_iter().flat_map(|mesh| &mesh.vertices))
    }

    /// Centre, metres.
    pub fn centre(&self) -> Vec3 {
        (self.min + self.max) * 0.5
    }

    /// Half the diagonal, at least 0.1 mm, metres.
    pub fn radius(&self) -> f32 {
        ((self.max - self.min).length() * 0.5).max(1e-4)
    }

    pub(crate) fn corners(&self) -> [Vec3; 8] {
        std::array::from_fn(|i| {
            let pick = |bit: usize, low: f32, high: f32| if i >> bit & 1 == 0 { low } else { high };
            Vec3::new(
                pick(0, self.min.x, self.max.x),
                pick(1, self.min.y, self.max.y),
                pick(2, self.min.z, self.max.z),
            )
        })
    }
}

/// Camera: transform from world to clip space, with depth from 0 (near) to 1 (far).
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_render::{Bounds, Camera, Projection, Result, View, silhouette};
///
/// let body = synthetic_body().mesh();
/// let bounds = Bounds::from_meshes([&body]).unwrap();
/// let covered = |view| -> Result<usize> {
///     let camera = Camera::framing(&bounds, view, Projection::Orthographic, 1.0);
///     let image = silhouette(&body, &camera, 64, 64)?;
///     Ok(image.pixels().iter().filter(|pixel| pixel[0] == 255).count())
/// };
/// // In the T-pose the front view covers more pixels than the side view.
/// assert!(covered(View::Front)? > covered(View::Side)?);
/// # Ok::<(), cape_render::Error>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Camera {
    pub(crate) view: Mat4,
    pub(crate) clip: Mat4,
    pub(crate) eye: Vec3,
    pub(crate) orthographic: bool,
}

impl Camera {
    /// Camera at `eye` that looks at `target`, y up, with clipping planes `near` and `far`, metres.
    ///
    /// `aspect` is width over height. An orthographic camera has the extent of a perspective one with a
    /// field of view of 0.5 radians at the target.
    pub fn look_at(
        eye: Vec3,
        target: Vec3,
        projection: Projection,
        aspect: f32,
        [near, far]: [f32; 2],
    ) -> Self {
        let projection_matrix = match projection {
            Projection::Perspective(fov) => directx::perspective(fov, aspect, near, far),
            Projection::Orthographic => {
                let half = 0.25_f32.tan() * eye.distance(target);
                directx::orthographic(-half * aspect, half * aspect, -half, half, near, far)
            }
        };
        Self::new(eye, target, projection_matrix, projection == Projection::Orthographic)
    }

    /// Camera that frames `bounds` from `view`, slightly elevated, with a margin; `aspect` is width over
    /// height.
    pub fn framing(bounds: &Bounds, view: View, projection: Projection, aspect: f32) -> Self {
        Self::orbit(bounds, view.azimuth(), 0.1, projection, aspect)
    }

    /// [`framing`](Self::framing) from any azimuth and elevation, radians.
    pub fn orbit(
        bounds: &Bounds,
        azimuth: f32,
        elevation: f32,
        projection: Projection,
        aspect: f32,
    ) -> Self {
        const MARGIN: f32 = 1.06;
        let elevation = elevation.clamp(-1.5, 1.5);
        let direction = Vec3::new(
            azimuth.sin() * elevation.cos(),
            elevation.sin(),
            azimuth.cos() * elevation.cos(),
        );
        let (centre, radius) = (bounds.centre(), bounds.radius());
        let axes = view::look_at_mat4(direction, Vec3::ZERO, Vec3::Y);
        let corners = bounds.corners().map(|corner| axes.transform_vector3(corner - centre));
        match projection {
            Projection::Orthographic => {
                let extent = |[x, y]: [f32; 2]| (x / aspect).max(y);
                let half = MARGIN
                    * corners.iter().map(|c| extent([c.x.abs(), c.y.abs()])).fold(1e-4, f32::max);
                let eye = centre + direction * (2.0 * radius);
                let matrix = directx::orthographic(
                    -half * aspect,
                    half * aspect,
                    -half,
                    half,
                    0.5 * radius,
                    3.5 * radius,
                );
                Self::new(eye, centre, matrix, true)
            }
            Projection::Perspective(fov) => {
                let fov = fov.clamp(0.02, 2.5);
                let tan = (fov * 0.5).tan() / MARGIN;
                let distance = corners
                    .iter()
                    .map(|c| (c.x.abs() / (tan * aspect)).max(c.y.abs() / tan) + c.z)
                    .fold(1.05 * radius, f32::max);
                let near = (distance - 1.5 * radius).max(distance * 0.02);
                let matrix = directx::perspective(fov, aspect, near, distance + 2.5 * radius);
                Self::new(centre + direction * distance, centre, matrix, false)
            }
        }
    }

    pub(crate) fn new(eye: Vec3, target: Vec3, projection: Mat4, orthographic: bool) -> Self {
        let forward = (target - eye).normalize_or(Vec3::NEG_Z);
        let up = if forward.y.abs() > 0.999 { Vec3::Z } else { Vec3::Y };
        let view = view::look_to_mat4(eye, forward, up);
        Self { view, clip: projection * view, eye, orthographic }
    }

    /// Unit vector from `point` towards the camera.
    pub(crate) fn towards(&self, point: Vec3) -> Vec3 {
        if self.orthographic {
            self.view.row(2).truncate()
        } else {
            (self.eye - point).normalize_or_zero()
        }
    }

    /// Origin and unit direction of the ray at image position (`x`, `y`), −1 to 1, y up.
    pub(crate) fn ray(inverse: &Mat4, x: f32, y: f32) -> (Vec3, Vec3) {
        let from = inverse.project_point3(Vec3::new(x, y, 0.0));
        let to = inverse.project_point3(Vec3::new(x, y, 1.0));
        (from, (to - from).normalize_or_zero())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_view_frames_the_whole_box_tightly() {
        let bounds = Bounds { min: Vec3::new(-0.9, -1.2, -0.2), max: Vec3::new(0.9, 0.6, 0.3) };
        let views = [View::Front, View::ThreeQuarter, View::Side, View::Back];
        for projection in [Projection::Orthographic, Projection::default()] {
            for view in views {
                for aspect in [0.5, 1.0, 1.7] {
                    let camera = Camera::framing(&bounds, view, projection, aspect);
                    let mut reach: f32 = 0.0;
                    for corner in bounds.corners() {
                        let clip = camera.clip.project_point3(corner);
                        assert!((0.0..=1.0).contains(&clip.z), "{view:?} {clip}");
                        reach = reach.max(clip.x.abs()).max(clip.y.abs());
                    }
                    assert!((0.8..=1.0).contains(&reach), "{view:?} {projection:?} {reach}");
                }
            }
        }
    }

    #[test]
    fn the_front_view_has_the_bodys_left_at_the_right() {
        let bounds = Bounds { min: Vec3::splat(-1.0), max: Vec3::splat(1.0) };
        let camera = Camera::framing(&bounds, View::Front, Projection::Orthographic, 1.0);
        assert!(camera.clip.project_point3(Vec3::X).x > 0.1);
        let camera = Camera::framing(&bounds, View::Back, Projection::Orthographic, 1.0);
        assert!(camera.clip.project_point3(Vec3::X).x < -0.1);
    }
}
