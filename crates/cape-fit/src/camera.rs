//! Pinhole camera.

use cape_render::Projection;
use glam::{DVec2, DVec3, Vec3};

use crate::{Error, Result};

/// Least depth, metres, to which smaller depths are clamped: a body stays in front of the camera.
const NEAREST: f64 = 0.05;
/// Largest side of an image, pixels.
const MAX_SIDE: u32 = cape_render::MAX_SIDE;

/// A pinhole camera at the origin that looks along −z, y up. The principal point is the centre of the
/// image, whose columns and rows are counted from the upper left corner.
///
/// ```
/// use cape_fit::PinholeCamera;
/// use glam::{DVec2, DVec3};
///
/// let camera = PinholeCamera::new(640, 480, None)?;
/// // The default focal length is the diagonal of the image.
/// assert_eq!(camera.focal(), 800.0);
/// assert_eq!(camera.project(DVec3::new(0.0, 0.0, -2.0)), DVec2::new(320.0, 240.0));
/// // Points above the optical axis are in the upper half.
/// assert_eq!(camera.project(DVec3::new(0.0, 0.5, -2.0)), DVec2::new(320.0, 40.0));
/// assert_eq!(camera.downscaled_to(320).height(), 240);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PinholeCamera {
    width: u32,
    height: u32,
    focal: f64,
}

impl PinholeCamera {
    /// A camera with an image of `width` × `height` pixels and the focal length `focal`, pixels; by
    /// default the diagonal of the image, a diagonal field of view of 53°.
    ///
    /// # Errors
    /// If a side is 0 or too large, or the focal length is not positive.
    pub fn new(width: u32, height: u32, focal: Option<f64>) -> Result<Self> {
        if width == 0 || height == 0 || width > MAX_SIDE || height > MAX_SIDE {
            return Err(Error::argument(format!(
                "camera: image of {width}×{height} pixels, expected sides of 1 to {MAX_SIDE}"
            )));
        }
        let focal = focal.unwrap_or_else(|| f64::from(width).hypot(f64::from(height)));
        if !(focal > 0.0 && focal.is_finite()) {
            return Err(Error::argument(format!(
                "camera: focal length {focal} pixels, expected above 0"
            )));
        }
        Ok(Self { width, height, focal })
    }

    /// Width of the image, pixels.
    pub fn width(&self) -> u32 {
        self.width
    }

    /// Height of the image, pixels.
    pub fn height(&self) -> u32 {
        self.height
    }

    /// Focal length, pixels.
    pub fn focal(&self) -> f64 {
        self.focal
    }

    /// The same camera with an image whose longer side is at most `side` pixels.
    #[must_use]
    pub fn downscaled_to(&self, side: u32) -> Self {
        let scale = f64::from(side) / f64::from(self.width.max(self.height));
        if scale >= 1.0 {
            return *self;
        }
        let scaled = |pixels: u32| ((f64::from(pixels) * scale).round() as u32).max(1);
        Self { width: scaled(self.width), height: scaled(self.height), focal: self.focal * scale }
    }

    /// Offset of a column and row from the principal point, pixels, y up.
    pub(crate) fn offset(&self, x: f64, y: f64) -> DVec2 {
        DVec2::new(x - 0.5 * f64::from(self.width), 0.5 * f64::from(self.height) - y)
    }

    /// Projects a point, metres, to column and row, pixels.
    pub fn project(&self, point: DVec3) -> DVec2 {
        let scale = self.focal / depth(point);
        DVec2::new(
            0.5 * f64::from(self.width) + scale * point.x,
            0.5 * f64::from(self.height) - scale * point.y,
        )
    }

    /// Gradient with respect to a point, from the gradient with respect to its column and row.
    pub fn pull_back(&self, point: DVec3, gradient: DVec2) -> DVec3 {
        let depth = depth(point);
        let scale = self.focal / depth;
        let along = if -point.z > NEAREST {
            scale / depth * (gradient.x * point.x - gradient.y * point.y)
        } else {
            0.0
        };
        DVec3::new(scale * gradient.x, -scale * gradient.y, along)
    }

    /// The camera of the renderer for depths from `near` to `far`, metres.
    pub fn to_render(&self, [near, far]: [f64; 2]) -> cape_render::Camera {
        let field = 2.0 * (0.5 * f64::from(self.height) / self.focal).atan();
        cape_render::Camera::look_at(
            Vec3::ZERO,
            Vec3::NEG_Z,
            Projection::Perspective(field as f32),
            self.width as f32 / self.height as f32,
            [near as f32, far as f32],
        )
    }
}

/// Depth of a point, metres, at least [`NEAREST`].
pub(crate) fn depth(point: DVec3) -> f64 {
    (-point.z).max(NEAREST)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn the_axes_point_right_and_up() {
        let camera = PinholeCamera::new(640, 480, Some(500.0)).unwrap();
        assert_eq!(camera.project(DVec3::new(0.0, 0.0, -3.0)), DVec2::new(320.0, 240.0));
        assert_eq!(camera.project(DVec3::new(0.3, 0.6, -3.0)), DVec2::new(370.0, 140.0));
        assert_eq!(camera.offset(370.0, 140.0), DVec2::new(50.0, 100.0));
        let small = camera.downscaled_to(320);
        assert_eq!((small.width(), small.height(), small.focal()), (320, 240, 250.0));
        assert_eq!(camera.downscaled_to(1000), camera);
        assert_eq!(PinholeCamera::new(300, 400, None).unwrap().focal(), 500.0);
    }

    #[test]
    fn impossible_cameras_are_refused() {
        assert!(PinholeCamera::new(0, 480, None).is_err());
        assert!(PinholeCamera::new(640, 100_000, None).is_err());
        for focal in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            assert!(PinholeCamera::new(640, 480, Some(focal)).is_err());
        }
    }

    proptest! {
        #[test]
        fn pulling_back_is_the_transposed_derivative(
            x in -2.0f64..2.0, y in -2.0f64..2.0, z in -6.0f64..-0.5,
            a in -1.0f64..1.0, b in -1.0f64..1.0,
        ) {
            let camera = PinholeCamera::new(512, 300, None).unwrap();
            let (point, gradient, step) = (DVec3::new(x, y, z), DVec2::new(a, b), 1e-6);
            let found = camera.pull_back(point, gradient);
            for axis in 0..3 {
                let change = DVec3::AXES[axis] * step;
                let difference = camera.project(point + change) - camera.project(point - change);
                let expected = difference.dot(gradient) / (2.0 * step);
                prop_assert!((found[axis] - expected).abs() < 1e-4 * (1.0 + expected.abs()));
            }
        }
    }
}
