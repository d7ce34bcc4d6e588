//! Signed distance field of smoothly blended implicit parts.
//!
//! Each part gives an approximate signed distance in metres, negative inside. The field is symmetric
//! in x = 0; parts are given for the left side (x ≥ 0).

use glam::{DMat3, DQuat, DVec3};

/// Distance from the bounding box of a part beyond which it has no influence, metres.
const MARGIN: f64 = 0.02;

/// Cross-section of a [`Tube`]; lengths in metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct CrossSection {
    /// Position along the axis of the tube.
    pub(super) at: f64,
    /// Centre in the two coordinates other than the axis, in the order x, y, z.
    pub(super) centre: [f64; 2],
    /// Half-widths towards −u, +u, −v, +v.
    pub(super) half: [f64; 4],
}

/// Generalised cylinder along a coordinate axis, with superelliptic cross-sections and monotone cubic
/// interpolation between them.
#[derive(Debug, Clone)]
pub(super) struct Tube {
    axis: usize,
    exponent: f64,
    caps: [f64; 2],
    at: Vec<f64>,
    /// Values and slopes of the six channels at each cross-section.
    values: Vec<[f64; 6]>,
    slopes: Vec<[f64; 6]>,
}

impl Tube {
    /// Tube through cross-sections in ascending order; `caps` are the lengths of its rounded ends.
    pub(super) fn new(
        axis: usize,
        exponent: f64,
        caps: [f64; 2],
        sections: &[CrossSection],
    ) -> Self {
        let at: Vec<f64> = sections.iter().map(|s| s.at).collect();
        let values: Vec<[f64; 6]> = sections
            .iter()
            .map(|s| {
                let ([u, v], [a, b, c, d]) = (s.centre, s.half);
                [u, v, a, b, c, d]
            })
            .collect();
        let slopes = monotone_slopes(&at, &values);
        Self { axis, exponent, caps, at, values, slopes }
    }

    /// Interpolated channels at axis position `t`, within the range of the cross-sections.
    fn section(&self, t: f64) -> [f64; 6] {
        let i = self.at[1..self.at.len() - 1].iter().take_while(|&&a| a <= t).count();
        let width = self.at[i + 1] - self.at[i];
        let s = (t - self.at[i]) / width;
        let (h1, h3) = (s * s * (3.0 - 2.0 * s), s * s * (s - 1.0) * width);
        let (h0, h2) = (1.0 - h1, s * (1.0 - s) * (1.0 - s) * width);
        std::array::from_fn(|c| {
            h0 * self.values[i][c]
                + h1 * self.values[i + 1][c]
                + h2 * self.slopes[i][c]
                + h3 * self.slopes[i + 1][c]
        })
    }

    fn distance(&self, p: DVec3) -> f64 {
        let (t, u, v) = match self.axis {
            0 => (p.x, p.y, p.z),
            1 => (p.y, p.x, p.z),
            _ => (p.z, p.x, p.y),
        };
        let (first, last) = (self.at[0], self.at[self.at.len() - 1]);
        let inside = t.clamp(first, last);
        let [cu, cv, un, up, vn, vp] = self.section(inside);
        let (du, dv, dt) = (u - cu, v - cv, t - inside);
        let a = if du < 0.0 { un } else { up };
        let b = if dv < 0.0 { vn } else { vp };
        let c = if dt < 0.0 { self.caps[0] } else { self.caps[1] };
        scaled_norm_distance(DVec3::new(du, dv, dt), DVec3::new(a, b, c), self.exponent)
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        let mut low = [f64::INFINITY; 2];
        let mut high = [f64::NEG_INFINITY; 2];
        for [u, v, un, up, vn, vp] in &self.values {
            low = [low[0].min(u - un), low[1].min(v - vn)];
            high = [high[0].max(u + up), high[1].max(v + vp)];
        }
        let (t0, t1) = (self.at[0] - self.caps[0], self.at[self.at.len() - 1] + self.caps[1]);
        match self.axis {
            0 => (DVec3::new(t0, low[0], low[1]), DVec3::new(t1, high[0], high[1])),
            1 => (DVec3::new(low[0], t0, low[1]), DVec3::new(high[0], t1, high[1])),
            _ => (DVec3::new(low[0], low[1], t0), DVec3::new(high[0], high[1], t1)),
        }
    }
}

/// Slopes of the monotone cubic through the cross-sections (Fritsch and Butland 1984).
fn monotone_slopes(at: &[f64], values: &[[f64; 6]]) -> Vec<[f64; 6]> {
    let secant = |i: usize, c: usize| (values[i + 1][c] - values[i][c]) / (at[i + 1] - at[i]);
    let last = at.len() - 1;
    (0..=last)
        .map(|i| {
            std::array::from_fn(|c| {
                if i == 0 {
                    return secant(0, c);
                }
                if i == last {
                    return secant(last - 1, c);
                }
                let (before, after) = (secant(i - 1, c), secant(i, c));
                if before * after <= 0.0 {
                    return 0.0;
                }
                let (h0, h1) = (at[i] - at[i - 1], at[i + 1] - at[i]);
                3.0 * (h0 + h1) / ((2.0 * h1 + h0) / before + (h1 + 2.0 * h0) / after)
            })
        })
        .collect()
}

/// First-order distance to the unit ball of the `n`-norm, scaled by `radii`.
fn scaled_norm_distance(d: DVec3, radii: DVec3, n: f64) -> f64 {
    let q = d.abs() / radii;
    let (norm, gradient) = if n == 2.0 {
        let norm = q.length();
        (norm, q / radii / norm)
    } else {
        let power = DVec3::new(q.x.powf(n - 1.0), q.y.powf(n - 1.0), q.z.powf(n - 1.0));
        let norm = power.dot(q).powf(1.0 / n);
        (norm, power / radii / norm.powf(n - 1.0))
    };
    if norm < 1e-3 {
        return -radii.min_element();
    }
    (norm - 1.0) / gradient.length()
}

/// Geometric primitive of a [`SdfPart`].
#[derive(Debug, Clone)]
pub(super) enum Primitive {
    /// A generalised cylinder.
    Tube(Tube),
    /// A chain of spheres joined by cones: centre and radius of each.
    Chain(Vec<(DVec3, f64)>),
    /// An ellipsoid.
    Ellipsoid {
        /// Centre.
        centre: DVec3,
        /// Semi-axes.
        radii: DVec3,
        /// Rotation of the semi-axes.
        rotation: DQuat,
    },
}

impl Primitive {
    fn distance(&self, p: DVec3) -> f64 {
        match self {
            Self::Tube(tube) => tube.distance(p),
            Self::Chain(nodes) => nodes
                .windows(2)
                .map(|pair| cone_distance(p, pair[0], pair[1]))
                .fold(f64::INFINITY, f64::min),
            Self::Ellipsoid { centre, radii, rotation } => {
                scaled_norm_distance(rotation.inverse() * (p - centre), *radii, 2.0)
            }
        }
    }

    fn bounds(&self) -> (DVec3, DVec3) {
        match self {
            Self::Tube(tube) => tube.bounds(),
            Self::Chain(nodes) => {
                nodes.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), &(c, r)| {
                    (low.min(c - r), high.max(c + r))
                })
            }
            Self::Ellipsoid { centre, radii, rotation } => {
                let axes = DMat3::from_quat(*rotation);
                let reach =
                    DVec3::from_array(std::array::from_fn(|i| (axes.row(i) * radii).length()));
                (centre - reach, centre + reach)
            }
        }
    }
}

/// Approximate distance to two spheres joined by a cone.
fn cone_distance(p: DVec3, (a, ra): (DVec3, f64), (b, rb): (DVec3, f64)) -> f64 {
    let axis = b - a;
    let t = ((p - a).dot(axis) / axis.length_squared()).clamp(0.0, 1.0);
    (p - a - axis * t).length() - (ra + (rb - ra) * t)
}

/// Implicit part with the width of its blend with earlier parts.
#[derive(Debug, Clone)]
pub(super) struct SdfPart {
    primitive: Primitive,
    blend: f64,
    /// True if the part blends with its mirror image near x = 0.
    paired: bool,
    low: DVec3,
    high: DVec3,
}

impl SdfPart {
    /// Part that blends with earlier parts within `blend` metres.
    pub(super) fn new(primitive: Primitive, blend: f64) -> Self {
        let (low, high) = primitive.bounds();
        let reach = blend + MARGIN;
        Self { primitive, blend, paired: false, low: low - reach, high: high + reach }
    }

    /// The part blended with its mirror image in x = 0.
    pub(super) fn mirrored(mut self) -> Self {
        self.paired = true;
        self
    }

    fn blend_with(&self, distance: f64, p: DVec3) -> f64 {
        if p.cmplt(self.low).any() || p.cmpgt(self.high).any() {
            return distance;
        }
        let mut d = self.primitive.distance(p);
        if self.paired && p.x < 2.0 * self.blend {
            let other = self.primitive.distance(DVec3::new(-p.x, p.y, p.z));
            d = smooth_min(d, other, self.blend);
        }
        smooth_min(distance, d, self.blend)
    }
}

/// Gaussian displacement of the surface, outwards or (negative) inwards.
#[derive(Debug, Clone, Copy)]
pub(super) struct Blob {
    /// Centre, metres.
    pub(super) centre: DVec3,
    /// Standard deviations along the axes, metres.
    pub(super) spread: DVec3,
    /// Height, metres.
    pub(super) amplitude: f64,
}

impl Blob {
    /// Displacement at `p`, metres.
    pub(super) fn height(&self, p: DVec3) -> f64 {
        let q = ((p - self.centre) / self.spread).length_squared();
        if q > 16.0 { 0.0 } else { self.amplitude * ((-0.5 * q).exp() - (-8.0_f64).exp()) }
    }
}

/// Twice differentiable minimum of `a` and `b`, rounded where they differ by less than `k`.
fn smooth_min(a: f64, b: f64, k: f64) -> f64 {
    let h = (k - (a - b).abs()).max(0.0) / k;
    a.min(b) - h * h * h * k / 6.0
}

/// Signed distance field of the body, symmetric in x = 0.
#[derive(Debug, Clone, Default)]
pub(super) struct BodySdf {
    /// Parts, blended in order.
    pub(super) parts: Vec<SdfPart>,
    /// Displacements of the blended surface.
    pub(super) blobs: Vec<Blob>,
}

impl BodySdf {
    /// Approximate signed distance at `p`, metres; negative inside.
    pub(super) fn distance(&self, p: DVec3) -> f64 {
        let p = DVec3::new(p.x.abs(), p.y, p.z);
        let far = 1.0;
        let d = self.parts.iter().fold(far, |d, part| part.blend_with(d, p));
        if d > 2.0 * MARGIN {
            return d;
        }
        d - self.blobs.iter().map(|blob| blob.height(p)).sum::<f64>()
    }

    /// Distance and gradient at `p` by finite differences over a tetrahedron.
    pub(super) fn distance_and_gradient(&self, p: DVec3) -> (f64, DVec3) {
        const STEP: f64 = 1e-5;
        const CORNERS: [DVec3; 4] = [
            DVec3::new(1.0, -1.0, -1.0),
            DVec3::new(-1.0, -1.0, 1.0),
            DVec3::new(-1.0, 1.0, -1.0),
            DVec3::new(1.0, 1.0, 1.0),
        ];
        let mut value = 0.0;
        let mut gradient = DVec3::ZERO;
        for corner in CORNERS {
            let d = self.distance(p + corner * STEP);
            value += d / 4.0;
            gradient += corner * (d / (4.0 * STEP));
        }
        (value, gradient)
    }

    /// Projects `p` onto the surface by `steps` Newton steps of at most 5 mm.
    pub(super) fn project(&self, mut p: DVec3, steps: usize) -> DVec3 {
        for _ in 0..steps {
            let (d, gradient) = self.distance_and_gradient(p);
            let step = gradient * (-d / gradient.length_squared().max(0.05));
            p += step.clamp_length_max(0.005);
        }
        p
    }
}
