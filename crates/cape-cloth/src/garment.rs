use cape_core::SmplModel;
use glam::DVec3;
use ndarray::{Array2, s};
use serde::Serialize;

use super::{
    isosurface::surface_nets,
    pattern::{cut, fair},
};
use crate::{Error, Result};
use cape_core::{
    geometry::{ClosestPoint, SurfaceIndex, SurfaceMesh, points},
    smpl::StandardPose,
};

/// Kinds of garments, each of its own topology.
///
/// See [`Garment`] for an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
pub enum GarmentKind {
    /// A body with sleeves.
    TShirt,
    /// Two legs from the waist.
    Shorts,
    /// A flared tube from the waist.
    Skirt,
    /// A T-shirt that ends in a skirt.
    Dress,
}

/// A garment's cut, in ratios to the body that it is made for.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_cloth::{Garment, GarmentKind};
///
/// let body = synthetic_body();
/// let skirt = Garment { resolution: 0.05, ..Garment::new(GarmentKind::Skirt) };
/// let sewn = skirt.sew(&body, &body.rest_shape(&[])?)?;
/// assert!(!sewn.waistband.is_empty());
/// // A longer one has the same topology, and reaches further down.
/// let longer = sewn.resize(&body, &Garment { length: 1.2 * skirt.length, ..skirt })?;
/// assert_eq!(longer.surface.faces, sewn.surface.faces);
/// let hem = |surface: &cape_core::geometry::SurfaceMesh| {
///     surface.vertices.iter().fold(f64::INFINITY, |low, vertex| low.min(vertex.y))
/// };
/// assert!(hem(&longer.surface) < hem(&sewn.surface));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Garment {
    /// The kind.
    pub kind: GarmentKind,
    /// Length below its top, relative to neck to hips (T-shirt) or hips to knees (others).
    pub length: f64,
    /// Width relative to the body's.
    pub width: f64,
    /// Length of the sleeves relative to shoulder to elbow.
    pub sleeve: f64,
    /// Length of the edges of triangles, metres.
    pub resolution: f64,
}

/// A garment made for a body with its arms lowered by 45°, between where arms mostly are and where
/// they may go: sleeves that are sewn further up bunch under hanging arms.
///
/// See [`Garment`] for an example.
#[derive(Debug, Clone, PartialEq)]
pub struct GarmentMesh {
    /// The garment around the body.
    pub surface: SurfaceMesh,
    /// Vertices of an elastic waistband, ascending; none if the garment hangs on the shoulders.
    pub waistband: Vec<u32>,
    /// The unclothed rest shape it was made for, metres, `[V, 3]`.
    pub body: Array2<f64>,
    /// Its cut.
    pub garment: Garment,
}

/// Axis-angles of the pose in which garments are made, `[72]`.
pub(super) fn sewing_pose(model: &SmplModel) -> Vec<f64> {
    StandardPose::A.angles(model.joints())
}

/// A body with the rest shape `[V, 3]` in the pose in which garments are made, and its joints.
pub(super) fn sewing_body(
    model: &SmplModel,
    shape: &Array2<f64>,
) -> Result<(SurfaceMesh, Vec<DVec3>)> {
    let posed = model.pose_shape(shape, &sewing_pose(model), [0.0; 3], None)?;
    let body = SurfaceMesh::from_rows("body", posed.vertices.view(), &model.faces)?;
    Ok((body, points(posed.joints.view())))
}

impl GarmentMesh {
    /// The same garment, vertex for vertex, in another size: longer or shorter below the waist, with
    /// other sleeves beyond the shoulders, wider or tighter along its normals.
    ///
    /// # Errors
    /// If `size` is of another kind, or out of its domain.
    pub fn resize(&self, model: &SmplModel, size: &Garment) -> Result<Self> {
        size.check(model)?;
        if size.kind != self.garment.kind {
            return Err(Error::argument(format!(
                "a {:?} cannot become a {:?} by another size",
                self.garment.kind, size.kind
            )));
        }
        let (body, joints) = sewing_body(model, &self.body)?;
        let solid = SurfaceIndex::new(&body);
        let [from, to] = [&self.garment, size].map(|cut| GarmentOutline::new(cut, &body, &joints));
        let along = |from: f64, to: f64| if from > 0.0 { to / from } else { 1.0 };
        let longer = along(from.waist - from.hem, to.waist - to.hem);
        let sleeves = along(from.sleeve, to.sleeve);
        let on_arms = |near: &ClosestPoint| -> f64 {
            let corners = body.faces[near.face as usize].iter().zip(near.barycentric);
            corners.map(|(&v, w)| w * model.weights.slice(s![v as usize, ARMS]).sum()).sum()
        };
        let normals = self.surface.vertex_normals();
        let mut sewn = Self { garment: *size, ..self.clone() };
        for (p, normal) in sewn.surface.vertices.iter_mut().zip(normals) {
            let arm = solid.closest(*p, f64::INFINITY).map_or(0.0, |near| on_arms(&near));
            let beyond = from.sleeve_coordinates(*p).0.max(0.0) * arm;
            let outward = DVec3::new(from.arm.x * p.x.signum(), from.arm.y, from.arm.z);
            let below = (from.waist - p.y).max(0.0);
            *p += normal * (to.ease_at(*p) - from.ease_at(*p));
            *p += outward * (beyond * (sleeves - 1.0));
            p.y -= below * (longer - 1.0);
        }
        Ok(sewn)
    }
}

impl Garment {
    /// The usual cut of a kind.
    pub fn new(kind: GarmentKind) -> Self {
        let (length, width, sleeve) = match kind {
            GarmentKind::TShirt => (1.15, 1.15, 0.6),
            GarmentKind::Shorts => (0.75, 1.12, 0.0),
            GarmentKind::Skirt => (0.85, 1.12, 0.0),
            GarmentKind::Dress => (0.85, 1.15, 0.3),
        };
        Self { kind, length, width, sleeve, resolution: 0.02 }
    }

    /// The parameters as numbers, for regression: length, width, sleeve, `[3]`.
    pub fn numbers(&self) -> [f64; 3] {
        [self.length, self.width, self.sleeve]
    }

    /// Makes the garment for an unclothed rest shape `[V, 3]`, metres: the surface at some distance
    /// from the body, joined with a flared tube for skirts, cut at hem, waist, sleeves and neck, its
    /// triangles evened out.
    pub fn sew(&self, model: &SmplModel, shape: &Array2<f64>) -> Result<GarmentMesh> {
        self.check(model)?;
        let (body, joints) = sewing_body(model, shape)?;
        let cutting = GarmentOutline::new(self, &body, &joints);
        let solid = SurfaceIndex::new(&body);
        let far = 4.0 * self.resolution + cutting.ease;
        let field = |p: DVec3| {
            let near = solid.closest(p, far).map_or(far, |near| near.signed_distance);
            (near - cutting.ease_at(p)).min(cutting.skirt_distance(p))
        };
        let margin = DVec3::splat(3.0 * self.resolution);
        let [low, high] = cutting.bounds();
        let whole = surface_nets(low - margin, high + margin, self.resolution, field);
        let mut cut = cut(&whole, |p| cutting.margin(p), 0.4 * self.resolution);
        if cut.faces.is_empty() {
            return Err(Error::argument(format!("{self:?} leaves nothing of a garment")));
        }
        fair(&mut cut, field, |p| cutting.margin(p));
        let surface = SurfaceMesh::new("garment", cut.vertices, cut.faces)?;
        let boundary = surface.boundary();
        let high = 0.5 * (cutting.waist + cutting.hem);
        let on_band = |v: &usize| cutting.banded && boundary[*v] && surface.vertices[*v].y > high;
        let waistband = (0..boundary.len()).filter(on_band).map(|v| v as u32).collect();
        Ok(GarmentMesh { surface, waistband, body: shape.clone(), garment: *self })
    }

    fn check(&self, model: &SmplModel) -> Result<()> {
        if model.joints() != cape_core::joints::JOINTS {
            return Err(Error::argument(format!(
                "garments need a body of 24 joints, not {}",
                model.joints()
            )));
        }
        for (name, value, range) in [
            ("length", self.length, 0.1..=2.0),
            ("width", self.width, 1.02..=2.0),
            ("sleeve", self.sleeve, 0.0..=1.6),
            ("resolution", self.resolution, 0.005..=0.05),
        ] {
            if !range.contains(&value) {
                return Err(Error::argument(format!(
                    "garment: {name} of {value}, expected {range:?}"
                )));
            }
        }
        Ok(())
    }
}

/// Where a garment runs around one body, metres.
struct GarmentOutline {
    kind: GarmentKind,
    ease: f64,
    /// Whether it is held at the waist.
    banded: bool,
    top: f64,
    hem: f64,
    /// Length from the shoulder along the upper arm, and that arm, the left.
    sleeve: f64,
    shoulder: DVec3,
    arm: DVec3,
    neck: DVec3,
    waist: f64,
    hips: f64,
    /// Half widths along x and z of waist and hips, and where their middle is.
    at_waist: [f64; 2],
    at_hips: [f64; 2],
    middle: f64,
    flare: f64,
}

/// Joints of both arms.
const ARMS: std::ops::Range<usize> = 16..24;

/// Radius of a neck opening without ease, metres.
const NECK: f64 = 0.085;

/// Radius that an arm is within, without ease, metres.
const ARM: f64 = 0.07;

/// From the neck's joint to above the shoulders, metres.
const SHOULDERS: f64 = 0.06;

/// Ease of a waistband, and how far below it the garment's is reached, metres.
const BAND: [f64; 2] = [0.005, 0.08];

/// Radius of the torso that a width of 1 stands for, metres.
const GIRTH: f64 = 0.14;

impl GarmentOutline {
    fn new(garment: &Garment, body: &SurfaceMesh, joints: &[DVec3]) -> Self {
        let (hip, knee, neck, waist) = (joints[1], joints[4], joints[12], joints[3].y);
        let (shoulder, elbow) = (joints[16], joints[18]);
        let ease = (garment.width - 1.0) * GIRTH;
        let half = |at: f64, ease: f64| {
            let near = body.vertices.iter().filter(|p| (p.y - at).abs() < 0.03 && p.x.abs() < 0.3);
            let (mut x, mut back, mut front) = (0.0f64, 0.0f64, 0.0f64);
            for p in near {
                (x, back, front) = (x.max(p.x.abs()), back.min(p.z), front.max(p.z));
            }
            ([x + ease, 0.5 * (front - back) + ease], 0.5 * (front + back))
        };
        let below = hip.y - garment.length * (hip.y - knee.y);
        let collar = neck.y + ease + SHOULDERS;
        let (top, hem, banded) = match garment.kind {
            GarmentKind::TShirt => (collar, neck.y - garment.length * (neck.y - hip.y), false),
            GarmentKind::Dress => (collar, below, false),
            GarmentKind::Shorts | GarmentKind::Skirt => (waist, below, true),
        };
        let (at_waist, middle) = half(waist, if banded { BAND[0] } else { ease });
        Self {
            kind: garment.kind,
            ease,
            banded,
            top,
            hem,
            sleeve: garment.sleeve * shoulder.distance(elbow),
            shoulder,
            arm: (elbow - shoulder).normalize_or_zero(),
            neck,
            waist,
            hips: hip.y,
            at_waist,
            at_hips: half(hip.y, ease).0,
            middle,
            flare: 0.25 * garment.width,
        }
    }

    /// Distance from the body at a place: less towards a waistband.
    fn ease_at(&self, p: DVec3) -> f64 {
        let t = ((self.waist - p.y) / BAND[1]).clamp(0.0, 1.0);
        if self.banded {
            BAND[0] + (self.ease - BAND[0]) * t * t * (3.0 - 2.0 * t)
        } else {
            self.ease
        }
    }

    /// How far a place is beyond the shoulder in the direction of the upper arm, and from its axis.
    fn sleeve_coordinates(&self, p: DVec3) -> (f64, f64) {
        let from = DVec3::new(p.x.abs(), p.y, p.z) - self.shoulder;
        let beyond = from.dot(self.arm);
        (beyond, (from - self.arm * beyond).length())
    }

    /// Roughly the distance from the tube of a skirt; infinite for other garments.
    fn skirt_distance(&self, p: DVec3) -> f64 {
        if matches!(self.kind, GarmentKind::TShirt | GarmentKind::Shorts) {
            return f64::INFINITY;
        }
        let down = self.waist - p.y;
        let t = (down / (self.waist - self.hips)).clamp(0.0, 1.0);
        let grown = if down > 0.0 { self.flare * down } else { down };
        let [a, b] = [0, 1].map(|k| {
            (self.at_waist[k] + t * (self.at_hips[k] - self.at_waist[k]) + grown).max(1e-3)
        });
        ((p.x / a).hypot((p.z - self.middle) / b) - 1.0) * a.min(b)
    }

    /// How far within the cut a place is, metres: negative where the garment is not.
    fn margin(&self, p: DVec3) -> f64 {
        let above = p.y - self.hem;
        match self.kind {
            GarmentKind::Shorts | GarmentKind::Skirt => above.min(self.waist - p.y),
            GarmentKind::TShirt | GarmentKind::Dress => {
                let (beyond, off) = self.sleeve_coordinates(p);
                let sleeve = (self.sleeve - beyond).max(off - ARM - self.ease);
                let opening = p.distance(self.neck) - NECK - self.ease;
                above.min(sleeve).min(opening)
            }
        }
    }

    fn bounds(&self) -> [DVec3; 2] {
        let depth = self.flare * (self.waist - self.hem).max(0.0) + self.ease;
        let sleeve = self.shoulder.x + self.arm.x * self.sleeve + ARM + self.ease;
        let wide = match self.kind {
            GarmentKind::TShirt => sleeve,
            GarmentKind::Dress => sleeve.max(self.at_hips[0] + depth),
            GarmentKind::Shorts | GarmentKind::Skirt => self.at_hips[0] + depth,
        };
        let deep = 0.2 + depth;
        [DVec3::new(-wide, self.hem, -deep), DVec3::new(wide, self.top, deep)]
    }
}
