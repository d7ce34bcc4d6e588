use cape_core::SmplModel;
use glam::DVec3;
use ndarray::Array2;

use super::{
    nets::surface_nets,
    tailor::{cut, fair},
};
use crate::{
    Error, Result,
    geometry::{Solid, Surface, points},
};

/// Kinds of garments, each of its own topology.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
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
#[derive(Debug, Clone, Copy, PartialEq)]
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

/// A garment made for a body in its rest pose (T).
#[derive(Debug, Clone, PartialEq)]
pub struct Sewn {
    /// The garment around the body.
    pub surface: Surface,
    /// Vertices of an elastic waistband, ascending; none if the garment hangs on the shoulders.
    pub waistband: Vec<u32>,
    /// The unclothed rest shape it was made for, metres, `[V, 3]`.
    pub body: Array2<f64>,
    /// Its cut.
    pub garment: Garment,
}

impl Sewn {
    /// The same garment, vertex for vertex, in another size: longer or shorter below the waist, with
    /// other sleeves beyond the shoulders, wider or tighter along its normals.
    ///
    /// # Errors
    /// If `size` is of another kind, or out of its domain.
    pub fn resized(&self, model: &SmplModel, size: &Garment) -> Result<Self> {
        size.check(model)?;
        if size.kind != self.garment.kind {
            return Err(Error::argument(format!(
                "a {:?} cannot become a {:?} by another size",
                self.garment.kind, size.kind
            )));
        }
        let body = Surface::of_rows("body", self.body.view(), &model.faces)?;
        let joints = points(model.rest_joints(&self.body)?.view());
        let [from, to] = [&self.garment, size].map(|cut| Cutting::new(cut, &body, &joints));
        let shoulder = joints[16].x.abs();
        let along = |from: f64, to: f64| if from > 0.0 { to / from } else { 1.0 };
        let longer = along(from.waist - from.hem, to.waist - to.hem);
        let sleeves = along(from.sleeve - shoulder, to.sleeve - shoulder);
        let normals = self.surface.vertex_normals();
        let mut sewn = Self { garment: *size, ..self.clone() };
        for (p, normal) in sewn.surface.vertices.iter_mut().zip(normals) {
            let below = (from.waist - p.y).max(0.0);
            let beyond = (p.x.abs() - shoulder).max(0.0);
            *p += normal * (to.ease - from.ease);
            p.y -= below * (longer - 1.0);
            p.x += p.x.signum() * beyond * (sleeves - 1.0);
        }
        Ok(sewn)
    }
}

impl Garment {
    /// The usual cut of a kind.
    pub fn of(kind: GarmentKind) -> Self {
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
    pub fn sew(&self, model: &SmplModel, shape: &Array2<f64>) -> Result<Sewn> {
        self.check(model)?;
        let body = Surface::of_rows("body", shape.view(), &model.faces)?;
        let joints = points(model.rest_joints(shape)?.view());
        let cutting = Cutting::new(self, &body, &joints);
        let solid = Solid::new(&body);
        let far = 4.0 * self.resolution + cutting.ease;
        let field = |p: DVec3| {
            let near = solid.closest(p, far).map_or(far, |near| near.signed_distance);
            (near - cutting.ease).min(cutting.flared(p))
        };
        let margin = DVec3::splat(3.0 * self.resolution);
        let [low, high] = cutting.bounds();
        let whole = surface_nets(low - margin, high + margin, self.resolution, field);
        let mut cut = cut(&whole, |p| cutting.margin(p), 0.4 * self.resolution);
        if cut.faces.is_empty() {
            return Err(Error::argument(format!("{self:?} leaves nothing of a garment")));
        }
        fair(&mut cut, field, |p| cutting.margin(p), FAIRING);
        let surface = Surface::new("garment", cut.vertices, cut.faces)?;
        let banded = matches!(self.kind, GarmentKind::Shorts | GarmentKind::Skirt);
        let boundary = surface.boundary();
        let high = 0.5 * (cutting.waist + cutting.hem);
        let on_band = |v: &usize| banded && boundary[*v] && surface.vertices[*v].y > high;
        let waistband = (0..boundary.len()).filter(on_band).map(|v| v as u32).collect();
        Ok(Sewn { surface, waistband, body: shape.clone(), garment: *self })
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
struct Cutting {
    kind: GarmentKind,
    ease: f64,
    top: f64,
    hem: f64,
    sleeve: f64,
    neck: DVec3,
    waist: f64,
    hips: f64,
    /// Half widths along x and z of waist and hips, and where their middle is.
    at_waist: [f64; 2],
    at_hips: [f64; 2],
    middle: f64,
    flare: f64,
}

/// Rounds of evening out triangles.
const FAIRING: usize = 20;

/// Radius of a neck opening without ease, metres.
const NECK: f64 = 0.085;

/// From the neck's joint to above the shoulders, metres.
const SHOULDERS: f64 = 0.06;

/// Radius of the torso that a width of 1 stands for, metres.
const GIRTH: f64 = 0.14;

impl Cutting {
    fn new(garment: &Garment, body: &Surface, joints: &[DVec3]) -> Self {
        let (hip, knee, neck) = (joints[1], joints[4], joints[12]);
        let (shoulder, elbow, waist) = (joints[16].x.abs(), joints[18].x.abs(), joints[3].y);
        let ease = (garment.width - 1.0) * GIRTH;
        let half = |at: f64| {
            let near = body.vertices.iter().filter(|p| (p.y - at).abs() < 0.03 && p.x.abs() < 0.3);
            let (mut x, mut back, mut front) = (0.0f64, 0.0f64, 0.0f64);
            for p in near {
                (x, back, front) = (x.max(p.x.abs()), back.min(p.z), front.max(p.z));
            }
            ([x + ease, 0.5 * (front - back) + ease], 0.5 * (front + back))
        };
        let ((at_waist, middle), (at_hips, _)) = (half(waist), half(hip.y));
        let below = hip.y - garment.length * (hip.y - knee.y);
        let (top, hem) = match garment.kind {
            GarmentKind::TShirt => (neck.y + ease + SHOULDERS, neck.y - garment.length * (neck.y - hip.y)),
            GarmentKind::Dress => (neck.y + ease + SHOULDERS, below),
            GarmentKind::Shorts | GarmentKind::Skirt => (waist, below),
        };
        Self {
            kind: garment.kind,
            ease,
            top,
            hem,
            sleeve: shoulder + garment.sleeve * (elbow - shoulder),
            neck,
            waist,
            hips: hip.y,
            at_waist,
            at_hips,
            middle,
            flare: 0.25 * garment.width,
        }
    }

    /// Roughly the distance from the tube of a skirt; infinite for other garments.
    fn flared(&self, p: DVec3) -> f64 {
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
                // The sleeves end at a plane that does not reach below the waist.
                let sleeve = (self.sleeve - p.x.abs()).max(self.waist - p.y);
                let opening = p.distance(self.neck) - NECK - self.ease;
                above.min(sleeve).min(opening)
            }
        }
    }

    fn bounds(&self) -> [DVec3; 2] {
        let depth = self.flare * (self.waist - self.hem).max(0.0) + self.ease;
        let wide = match self.kind {
            GarmentKind::TShirt => self.sleeve.max(0.3),
            GarmentKind::Dress => self.sleeve.max(self.at_hips[0] + depth),
            GarmentKind::Shorts | GarmentKind::Skirt => self.at_hips[0] + depth,
        };
        let deep = 0.2 + depth;
        [DVec3::new(-wide, self.hem, -deep), DVec3::new(wide, self.top, deep)]
    }
}
