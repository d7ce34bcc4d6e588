use cape_core::SmplModel;
use glam::DVec3;
use ndarray::{Array2, s};
use serde::Serialize;

use super::{
    isosurface::surface_nets,
    pattern::{cut, fair},
    reinforce::CUFF,
};
use crate::{Error, Result};
use cape_core::{
    geometry::{ClosestPoint, SurfaceIndex, SurfaceMesh, points},
    smpl::StandardPose,
};

/// Kind of garment; each has its own topology.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize)]
pub enum GarmentKind {
    /// A T-shirt.
    TShirt,
    /// Shorts from the waist.
    Shorts,
    /// A flared skirt from the waist.
    Skirt,
    /// A dress: a T-shirt that ends in a skirt.
    Dress,
}

/// Cut of a garment, in ratios to the body that it is sewn for.
///
/// ```
/// use cape_synth::synthetic_body;
/// use cape_cloth::{Garment, GarmentKind};
///
/// let body = synthetic_body();
/// let skirt = Garment { resolution: 0.05, ..Garment::new(GarmentKind::Skirt) };
/// let sewn = skirt.sew(&body, &body.rest_shape(&[])?)?;
/// assert!(!sewn.waistband.is_empty());
/// // A longer one has the same topology and a lower hem.
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
    /// Kind.
    pub kind: GarmentKind,
    /// Length, relative to the distance from neck to hips (T-shirt) or from hips to knees (others).
    pub length: f64,
    /// Width; the distance from the body is `(width − 1) · 0.14` m, 0.14 m being the radius of a
    /// torso.
    pub width: f64,
    /// Length of the sleeves, relative to the distance from shoulder to elbow.
    pub sleeve: f64,
    /// Length of the edges, metres.
    pub resolution: f64,
    /// Width of the hems, metres: bands along all edges in which the cloth is double.
    pub hem: f64,
    /// True for elastic cuffs at the ends of sleeves, or of legs.
    pub cuffs: bool,
}

/// A garment mesh around a body in the A-pose, arms lowered by 45°: sleeves that are sewn in the
/// T-pose bunch under hanging arms.
#[derive(Debug, Clone, PartialEq)]
pub struct GarmentMesh {
    /// Surface around the body in the A-pose.
    pub surface: SurfaceMesh,
    /// Vertices of the elastic waistband, ascending; empty if the garment hangs on the shoulders.
    pub waistband: Vec<u32>,
    /// Vertices of the elastic cuffs, ascending; empty if the garment has none.
    pub cuffs: Vec<u32>,
    /// Unclothed rest shape of the body that it is sewn for, metres, `[V, 3]`.
    pub body: Array2<f64>,
    /// Cut.
    pub garment: Garment,
}

/// Axis-angles of the pose in which garments are sewn, radians, `[72]`.
pub(super) fn sewing_pose(model: &SmplModel) -> Vec<f64> {
    StandardPose::A.angles(model.joints())
}

/// Surface of a body with the rest shape `[V, 3]` in the pose in which garments are sewn, and its
/// joints, metres.
pub(super) fn sewing_body(
    model: &SmplModel,
    shape: &Array2<f64>,
) -> Result<(SurfaceMesh, Vec<DVec3>)> {
    let posed = model.pose_shape(shape, &sewing_pose(model), [0.0; 3], None)?;
    let body = SurfaceMesh::from_rows("body", posed.vertices.view(), &model.faces)?;
    Ok((body, points(posed.joints.view())))
}

impl GarmentMesh {
    /// The same topology in another size: stretched below the waist, along the sleeves beyond the
    /// shoulders, and along its normals.
    ///
    /// # Errors
    /// If `size` has another kind or is out of range.
    pub fn resize(&self, model: &SmplModel, size: &Garment) -> Result<Self> {
        size.check(model)?;
        if size.kind != self.garment.kind {
            return Err(Error::argument(format!(
                "garment: a {:?} cannot be resized to a {:?}, expected the same kind",
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
        let mut cuffs = Vec::new();
        for (v, (p, normal)) in sewn.surface.vertices.iter_mut().zip(normals).enumerate() {
            let at = *p;
            let arm = solid.closest(*p, f64::INFINITY).map_or(0.0, |near| on_arms(&near));
            let beyond = from.sleeve_coordinates(*p).0.max(0.0) * arm;
            let outward = DVec3::new(from.arm.x * p.x.signum(), from.arm.y, from.arm.z);
            let below = (from.waist - p.y).max(0.0);
            *p += outward * (beyond * (sleeves - 1.0));
            p.y -= below * (longer - 1.0);
            if to.on_cuff(*p) {
                cuffs.push(v as u32);
            }
            *p += normal * (to.ease_at(*p) - from.ease_at(at));
        }
        Ok(Self { cuffs, ..sewn })
    }
}

impl Garment {
    /// Default cut of a kind.
    pub fn new(kind: GarmentKind) -> Self {
        let (length, width, sleeve) = match kind {
            GarmentKind::TShirt => (1.15, 1.15, 0.6),
            GarmentKind::Shorts => (0.75, 1.12, 0.0),
            GarmentKind::Skirt => (0.85, 1.12, 0.0),
            GarmentKind::Dress => (0.85, 1.15, 0.3),
        };
        Self { kind, length, width, sleeve, resolution: 0.02, hem: 0.02, cuffs: false }
    }

    /// Semantic parameters for regression: length, width, sleeve, `[3]`.
    pub fn numbers(&self) -> [f64; 3] {
        [self.length, self.width, self.sleeve]
    }

    /// Sews the garment for a body with the unclothed rest shape `[V, 3]`, metres: an offset
    /// surface of the body, united with a flared tube for skirts, cut at hem, waist, sleeves and
    /// neck, and faired.
    ///
    /// # Errors
    /// If the body does not have SMPL's 24 joints, or the cut is out of range or leaves no surface.
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
            return Err(Error::argument(format!(
                "garment: {self:?} leaves no surface: use a greater length or a finer resolution"
            )));
        }
        fair(&mut cut, field, |p| cutting.margin(p));
        let surface = SurfaceMesh::new("garment", cut.vertices, cut.faces)?;
        let boundary = surface.boundary();
        let high = 0.5 * (cutting.waist + cutting.hem);
        let on_band = |v: &usize| cutting.banded && boundary[*v] && surface.vertices[*v].y > high;
        let all = 0..boundary.len();
        let waistband = all.clone().filter(on_band).map(|v| v as u32).collect();
        let on_cuff = |v: &usize| cutting.on_cuff(surface.vertices[*v]);
        let cuffs = all.filter(on_cuff).map(|v| v as u32).collect();
        Ok(GarmentMesh { surface, waistband, cuffs, body: shape.clone(), garment: *self })
    }

    fn check(&self, model: &SmplModel) -> Result<()> {
        if model.joints() != cape_core::joints::JOINTS {
            return Err(Error::argument(format!(
                "garment: a body of {} joints, expected SMPL's 24",
                model.joints()
            )));
        }
        for (name, value, range) in [
            ("length", self.length, 0.1..=2.0),
            ("width", self.width, 1.02..=2.0),
            ("sleeve", self.sleeve, 0.0..=2.0),
            ("resolution", self.resolution, 0.005..=0.05),
            ("hem", self.hem, 0.0..=0.1),
        ] {
            if !range.contains(&value) {
                return Err(Error::argument(format!(
                    "garment: {name} {value}, expected {range:?}"
                )));
            }
        }
        if self.cuffs && self.kind == GarmentKind::Skirt {
            return Err(Error::argument("garment: a skirt with cuffs, expected sleeves or legs"));
        }
        Ok(())
    }
}

/// Outline of a garment around one body, metres.
struct GarmentOutline {
    kind: GarmentKind,
    ease: f64,
    /// True for garments with a waistband.
    banded: bool,
    /// True for garments with elastic cuffs.
    cuffs: bool,
    top: f64,
    hem: f64,
    /// Length of the sleeves from the shoulder, and the left shoulder and direction of its upper arm.
    sleeve: f64,
    shoulder: DVec3,
    arm: DVec3,
    neck: DVec3,
    waist: f64,
    hips: f64,
    /// Half widths of waist and hips along x and z, and the z coordinate of their centre.
    at_waist: [f64; 2],
    at_hips: [f64; 2],
    middle: f64,
    flare: f64,
}

/// Joints of both arms, shoulders included.
const ARMS: std::ops::Range<usize> = 16..24;

/// Radius of the neck opening without ease, metres.
const NECK: f64 = 0.085;

/// Radius around an arm without ease, metres.
const ARM: f64 = 0.07;

/// Height of the collar above the neck joint, metres.
const SHOULDERS: f64 = 0.06;

/// Ease of waistband and cuffs, and distance from them at which the ease of the garment is reached, metres.
const BAND: [f64; 2] = [0.005, 0.08];

/// Radius of the torso at width 1, metres.
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
            cuffs: garment.cuffs,
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

    /// Distance of the garment from the body at a point, metres; less towards a waistband and cuffs.
    fn ease_at(&self, p: DVec3) -> f64 {
        let band = if self.banded { self.waist - p.y } else { f64::INFINITY };
        let t = (band.min(self.above_cuff(p)) / BAND[1]).clamp(0.0, 1.0);
        BAND[0] + (self.ease - BAND[0]) * t * t * (3.0 - 2.0 * t)
    }

    /// Distance of a point from the cuff along the limb, metres, negative on the cuff; infinite away from
    /// limbs with cuffs.
    fn above_cuff(&self, p: DVec3) -> f64 {
        if !self.cuffs {
            return f64::INFINITY;
        }
        match self.kind {
            GarmentKind::Skirt => f64::INFINITY,
            GarmentKind::Shorts => p.y - self.hem - CUFF,
            GarmentKind::TShirt | GarmentKind::Dress => {
                let (beyond, off) = self.sleeve_coordinates(p);
                let on_arm = beyond > 0.0 && off < ARM + self.ease;
                if on_arm { self.sleeve - beyond - CUFF } else { f64::INFINITY }
            }
        }
    }

    /// True on cuffs.
    fn on_cuff(&self, p: DVec3) -> bool {
        self.above_cuff(p) < 1e-6
    }

    /// Coordinate of a point along the upper arm from the shoulder, and its distance from the axis,
    /// metres.
    fn sleeve_coordinates(&self, p: DVec3) -> (f64, f64) {
        let from = DVec3::new(p.x.abs(), p.y, p.z) - self.shoulder;
        let beyond = from.dot(self.arm);
        (beyond, (from - self.arm * beyond).length())
    }

    /// Approximate signed distance from the tube of a skirt, metres; infinite for other garments.
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

    /// Distance of a point inside the outline of the cut, metres; negative outside.
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
