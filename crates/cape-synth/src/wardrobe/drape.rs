//! Displacement of one vertex by the garments: coverage, folds, sag.

use glam::DVec3;

use super::{
    drape_offsets::DrapeOffsets,
    joint_bends::{JointBend, JointBends},
    outfit_style::{OutfitStyle, Shirt, Trousers},
};
use crate::regions::{LimbSite, Regions, VertexSite, joint};

/// Smallest offset of the cloth from the skin, metres.
const CLOTH_OFFSET: f64 = 0.002;
/// Width of the transition from cloth to skin at a hem, metres; less than an edge of the mesh.
const HEM_WIDTH: f64 = 0.004;

/// Distances of a vertex from the hems of both garments.
#[derive(Debug, Clone, Copy)]
pub(super) struct HemDistances {
    pub(super) shirt: HemDistance,
    pub(super) trousers: HemDistance,
}

/// Distance of a vertex from the nearest hem of a garment.
#[derive(Debug, Clone, Copy)]
pub(super) struct HemDistance {
    /// Distance inside the garment, metres; negative outside.
    pub(super) distance: f64,
    /// Direction towards the hem, unit.
    pub(super) hem: DVec3,
    /// Coverage of the vertex, 0 to 1.
    pub(super) cover: f64,
}

impl HemDistance {
    const UNCOVERED: Self = Self { distance: -1.0, hem: DVec3::ZERO, cover: 0.0 };

    /// Distance from the nearest of `hems`. Coverage extends half an edge beyond the hem, because the
    /// vertices next to it are moved onto its curve.
    fn new(site: &VertexSite, hems: &[(f64, DVec3)]) -> Self {
        let nearest = hems.iter().min_by(|a, b| a.0.total_cmp(&b.0));
        nearest.map_or(Self::UNCOVERED, |&(distance, hem)| Self {
            distance,
            hem,
            cover: smooth((distance + 0.5 * site.edge) / HEM_WIDTH),
        })
    }
}

impl HemDistances {
    pub(super) fn new(regions: &Regions, site: &VertexSite, style: &OutfitStyle) -> Self {
        if !site.clothed {
            return Self { shirt: HemDistance::UNCOVERED, trousers: HemDistance::UNCOVERED };
        }
        let (shirt, trousers) = (&style.shirt, &style.trousers);
        let joints = &regions.joints;
        let p = site.position;
        let waist = joints[joint::SPINE[0]].y - 0.035 + trousers.waist + 0.02 * site.angle.cos();
        let collar = collar(joints, p) - shirt.collar;
        if site.arm_weight > 0.5 {
            let left = (shirt.sleeve_end[site.side] - site.arm.along) * site.arm.length;
            let hems = [(left, site.arm.axis), (collar.max(0.03), DVec3::ZERO)];
            return Self { shirt: HemDistance::new(site, &hems), trousers: HemDistance::UNCOVERED };
        }
        let above = p.y - hem(joints, site, shirt, waist);
        let over = HemDistance::new(site, &[(above, DVec3::NEG_Y), (collar, -NECKLINE)]);
        let under = (waist - p.y, DVec3::Y);
        let trousers = if site.leg_weight > 0.3 {
            let left = (trousers.leg_end[site.side] - site.leg.along) * site.leg.length;
            HemDistance::new(site, &[under, (left, site.leg.axis)])
        } else {
            HemDistance::new(site, &[under])
        };
        Self { shirt: over, trousers }
    }
}

/// Normal of the plane of the neckline, towards the shirt; the neckline is lower in front.
const NECKLINE: DVec3 = DVec3::new(0.0, -0.876, -0.482);

/// Distance below the plane of the neckline, metres.
fn collar(joints: &[DVec3], p: DVec3) -> f64 {
    let neck = joints[joint::NECK];
    let base = neck.lerp(joints[joint::HEAD], 0.12);
    (p - base).dot(NECKLINE)
}

/// Height of the hem of the shirt at a vertex, metres.
fn hem(joints: &[DVec3], site: &VertexSite, shirt: &Shirt, waist: f64) -> f64 {
    if shirt.tucked {
        return waist - 0.03;
    }
    let hips = (joints[joint::HIPS[0]] + joints[joint::HIPS[1]]) * 0.5;
    let from = site.position - hips;
    let [wave, phase] = shirt.hem_wave;
    hips.y
        + shirt.hem
        + shirt.hem_slope[0] * from.x
        + shirt.hem_slope[1] * from.z
        + wave * (3.0 * site.angle + phase).sin()
}

/// Inputs of the displacement of one frame: outfit style, joint bends, time.
pub(super) struct DrapeContext<'a> {
    pub(super) style: &'a OutfitStyle,
    pub(super) bends: &'a JointBends,
    /// Time, seconds.
    pub(super) time: f64,
}

/// Displacement as normal component and tangential shift, metres.
#[derive(Debug, Clone, Copy, Default)]
struct SplitDisplacement {
    normal: f64,
    shift: DVec3,
}

impl DrapeContext<'_> {
    /// Clothing displacement of a vertex, metres.
    pub(super) fn displacement(
        &self,
        site: &VertexSite,
        drape: &DrapeOffsets,
        hems: &HemDistances,
    ) -> DVec3 {
        let (shirt, trousers) = (hems.shirt.cover, hems.trousers.cover);
        if shirt + trousers <= 0.0 {
            return DVec3::ZERO;
        }
        let down: DVec3 =
            site.bones.iter().map(|&(joint, weight)| self.bends.down[joint] * weight).sum();
        let crumple = self.crumple(site);
        let mut upper = SplitDisplacement::default();
        let mut lower = SplitDisplacement::default();
        if shirt > 0.0 {
            upper = self.shirt(site, drape, hems.shirt, down, crumple);
        }
        if trousers > 0.0 {
            lower = self.trousers(site, drape, hems.trousers, down, crumple);
        }
        // The outer garment rests on the inner one.
        let tucked = self.style.shirt.tucked;
        let (inner, outer) = if tucked { (shirt, trousers) } else { (trousers, shirt) };
        let (below, above) = if tucked { (upper, lower) } else { (lower, upper) };
        let normal = outer * above.normal + inner * below.normal * (1.0 - 0.55 * outer);
        let shift = above.shift * outer + below.shift * (inner * (1.0 - 0.7 * outer));
        site.normal * normal.min(clearance(site)) + shift
    }

    fn shirt(
        &self,
        site: &VertexSite,
        drape: &DrapeOffsets,
        inside: HemDistance,
        down: DVec3,
        crumple: SplitDisplacement,
    ) -> SplitDisplacement {
        let OutfitStyle { shirt, lengths, .. } = self.style;
        let side = site.side;
        let arm = smooth((site.arm_weight - 0.2) / 0.6);
        let hanging = (1.0 - site.height).clamp(0.0, 1.15);
        let body_fit = if shirt.tucked {
            // Bloused above the waistband.
            0.25 + 0.7 * bump((site.height - 0.32) / 0.25)
        } else {
            0.14 + 0.7 * smooth(hanging / 0.95)
        };
        let end = shirt.sleeve_end[side];
        let reached = (site.arm.along / end).clamp(0.0, 1.0);
        let sleeve_fit = if lengths.long_sleeves {
            // Wide at the upper arm, gathered at the cuff.
            0.5 * smooth(reached / 0.25) + 0.1 + 0.5 * bump((reached - 0.5) / 0.5)
                - 0.25 * smooth((reached - 0.86) / 0.1)
        } else {
            0.15 + 0.95 * smooth(1.1 * reached)
        };
        let ease = mix(shirt.ease * body_fit, shirt.sleeve_ease * sleeve_fit, arm);
        let facing = site.normal.dot(down);
        let mut offset = SplitDisplacement {
            normal: CLOTH_OFFSET + ease * stand_off(facing),
            shift: DVec3::ZERO,
        };

        // Vertical folds from chest and shoulder blades.
        let body = 1.0 - arm;
        let depth = (0.004 + 0.35 * shirt.ease) * body * smooth(hanging / 0.9);
        let slanted = |[count, phase, slant]: [f64; 3]| {
            ridge(count * site.angle + phase + slant * 4.0 * hanging + 1.2 * self.bends.waist.twist)
        };
        offset.normal += depth * (0.75 * slanted(shirt.folds) + 0.6 * slanted(shirt.gathers));
        let ring = ridge(7.0 * reached + 2.0 * site.arm.angle + shirt.sleeve_phase[side]);
        offset.normal += arm * sleeve_fit * (0.0012 + 0.3 * shirt.sleeve_ease) * ring;
        offset.normal += crumple.normal * (0.35 + 30.0 * ease);

        // Folds at the joints.
        let loose = 0.75 + 22.0 * ease;
        let elbow =
            wrinkles(site, &self.bends.elbows[side], Wrinkle::ELBOW, shirt.sleeve_phase[side]);
        let shoulder =
            wrinkles(site, &self.bends.shoulders[side], Wrinkle::SHOULDER, shirt.folds[1]);
        let waist = wrinkles(site, &self.bends.waist, Wrinkle::WAIST, shirt.gathers[1]);
        let lap = wrinkles(site, &self.bends.hips[side], Wrinkle::HIP, shirt.gathers[1]);
        offset.normal += loose * (arm * elbow + shoulder + body * (waist + 0.7 * lap));

        // Tangential shifts.
        let spin = site.arm.around()
            * (shirt.sleeve_twist[side] * (0.4 + 0.6 * reached)
                + 0.006 * self.bends.elbows[side].twist.clamp(-1.0, 1.0));
        let raised = -self.bends.shoulders[side].inside.y * self.bends.shoulders[side].angle;
        let pull = 0.006 * (raised + 0.8) - 0.008 * self.bends.elbows[side].angle * reached;
        let along = site.arm.axis * (shirt.sleeve_slide[side] * (0.5 + 0.5 * reached) + pull);
        let lateral = (site.position.x.abs() / 0.15).min(1.0);
        let lifted = 0.011 * (-raised).max(-0.6) * lateral * (1.0 - 0.35 * hanging);
        let turned = shirt.twist * (0.25 + 0.75 * hanging) + 0.014 * self.bends.waist.twist;
        let around = DVec3::Y.cross(DVec3::new(site.normal.x, 0.0, site.normal.z));
        let lean = DVec3::new(shirt.lean[0], 0.0, shirt.lean[1]) * (hanging * hanging);
        let bowed = 0.018 * self.bends.waist.angle * site.normal.dot(self.bends.waist.inside);
        let [sway, speed] = self.style.sway;
        let swing = (6.0 * speed * self.time + sway).sin() * 0.0025 * hanging;
        let trunk = around * turned
            + DVec3::Y * (shirt.ride + 0.004 - lifted - bowed * (0.4 + 0.6 * hanging))
            + lean
            + DVec3::new(swing, 0.0, 0.6 * swing);
        offset.shift = trunk * body + (along + spin) * arm + crumple.shift;
        offset.shift += (down - site.normal * facing) * (0.3 * ease);
        let below = smooth((1.0 - site.height) / 0.35);
        let straight = if shirt.tucked { 0.6 * body_fit } else { below };
        let draped = drape.body * (body * straight) + drape.sleeve * (arm * 0.7);
        offset.shift += draped * (shirt.drape * hang_freedom(facing));
        offset.finish(site, inside)
    }

    fn trousers(
        &self,
        site: &VertexSite,
        drape: &DrapeOffsets,
        inside: HemDistance,
        down: DVec3,
        crumple: SplitDisplacement,
    ) -> SplitDisplacement {
        let OutfitStyle { trousers, lengths, .. } = self.style;
        let side = site.side;
        let leg = smooth((site.leg_weight - 0.25) / 0.5);
        let reached = (site.leg.along / trousers.leg_end[side]).clamp(0.0, 1.0);
        let below_waist = smooth(inside.distance.min(0.16) / 0.16);
        let ease = trousers.ease * mix(0.15 + 0.55 * below_waist, fit(trousers, reached), leg);
        let facing = site.normal.dot(down);
        let back = smooth(0.5 - 0.5 * site.angle.cos());
        let mut offset = SplitDisplacement {
            normal: CLOTH_OFFSET
                + ease * stand_off(facing)
                + trousers.seat * back * below_waist * (1.0 - leg),
            shift: DVec3::ZERO,
        };
        let LimbSite { length, along, angle, .. } = site.leg;
        let hips = &self.bends.hips[side];
        let knees = &self.bends.knees[side];
        // Lengthwise folds, and folds that stack above the shoe.
        let slant = trousers.twist[side] * 160.0 + hips.twist;
        let lengthwise = ridge(3.0 * angle + trousers.fold_phase[side] + slant * along * 4.0);
        offset.normal += leg * (0.0022 + 0.3 * ease) * smooth(reached * 2.0) * lengthwise;
        if lengths.long_legs {
            let above = (trousers.leg_end[side] - along) * length;
            let straight = 1.0 - 0.6 * smooth(knees.angle / 1.2);
            let phase = trousers.stack_phase[side];
            let part = 0.5 + 0.5 * (angle + phase).cos();
            let ring = part * ridge(above * 88.0 + phase + 1.6 * (angle - phase).sin());
            offset.normal +=
                leg * trousers.stack * straight * ring * (-(above / 0.13).powi(2)).exp();
        }
        offset.normal += crumple.normal * (0.35 + 34.0 * ease);

        let loose = 0.75 + 22.0 * ease;
        let knee = wrinkles(site, knees, Wrinkle::KNEE, trousers.fold_phase[side]);
        let hip = wrinkles(site, hips, Wrinkle::HIP, trousers.fold_phase[side]);
        offset.normal += loose * (leg * knee + hip);

        // Knee flexion pulls the trouser leg up, hip flexion pulls the seat down.
        let pull = -0.016 * knees.angle * smooth((reached - 0.25) / 0.6)
            - 0.010 * hips.angle * reached.min(0.5);
        let along = site.leg.axis * (trousers.slide[side] * (0.5 + 0.5 * reached) + 0.008 + pull);
        let turn = trousers.twist[side] * (0.35 + 0.65 * reached) + 0.012 * hips.twist;
        let around = site.leg.around() * turn;
        let flexed = hips.inside.z * hips.angle;
        let seat = DVec3::Y * (-0.009 - 0.010 * flexed * back + 0.005 * flexed * (1.0 - back));
        let [sway, speed] = self.style.sway;
        let swing = (5.0 * speed * self.time + sway + 2.0 * side as f64).sin() * 0.002 * reached;
        offset.shift = (along + around + DVec3::new(0.4 * swing, 0.0, swing)) * leg
            + seat * (1.0 - leg)
            + crumple.shift;
        offset.shift += (down - site.normal * facing) * (0.3 * ease);
        offset.shift += drape.leg * (leg * trousers.drape * hang_freedom(facing));
        offset.finish(site, inside)
    }

    /// Random crumple pattern.
    fn crumple(&self, site: &VertexSite) -> SplitDisplacement {
        let bend = self.bends.waist.angle * self.bends.waist.inside.z;
        let drift = 0.25 * (0.9 * self.time + self.style.sway[0]).sin();
        let mut offset = SplitDisplacement::default();
        for wave in &self.style.crumple {
            let phase = wave.vector.dot(site.position) + wave.phase + wave.follow * bend + drift;
            let (sin, cos) = phase.sin_cos();
            offset.normal += wave.amplitude * sin;
            offset.shift += wave.drag * cos;
        }
        offset.shift -= site.normal * site.normal.dot(offset.shift);
        offset
    }
}

impl SplitDisplacement {
    /// Keeps the cloth above the skin, thickens the hem, and moves the last vertices inside it onto the
    /// curve of the hem.
    fn finish(self, site: &VertexSite, inside: HemDistance) -> Self {
        let above = self.normal - 0.0015;
        let lifted = 0.0015 + 0.5 * (above + above.hypot(0.003));
        let seam = 0.0014 * (-(inside.distance / 0.012).powi(2)).exp();
        let beyond = (inside.distance - 0.4 * site.edge) / site.edge;
        let snap = inside.distance * (1.0 - smooth(beyond));
        Self { normal: lifted + seam, shift: self.shift + inside.hem * snap }
    }
}

/// Relative ease of a trouser leg along the leg.
fn fit(trousers: &Trousers, reached: f64) -> f64 {
    0.7 + trousers.flare * 0.8 * reached * reached
}

/// Relative stand-off of cloth from a surface that faces down (1), sideways (0) or up (−1).
fn stand_off(facing: f64) -> f64 {
    0.2 + 0.9 * smooth(0.45 + 0.6 * facing)
}

/// Relative freedom of cloth to drape away from such a surface.
fn hang_freedom(facing: f64) -> f64 {
    0.3 + 0.7 * smooth(0.65 + 0.7 * facing)
}

/// Largest normal displacement without intersection of the thighs, metres.
fn clearance(site: &VertexSite) -> f64 {
    let sign = if site.side == 0 { 1.0 } else { -1.0 };
    let inward = -site.normal.x * sign * smooth(site.leg_weight * 2.0);
    if inward > 0.1 { (0.85 * site.position.x.abs() / inward).max(0.001) } else { 0.08 }
}

/// Shape of the folds around a joint; lengths in metres.
struct Wrinkle {
    /// Extent along the bone to either side.
    extent: f64,
    /// Extent across the bone.
    across: f64,
    /// Distance between folds.
    spacing: f64,
    /// Height at full bend.
    height: f64,
    /// Inward displacement on the outside of the bend.
    stretch: f64,
    /// Bend angle without folds, radians.
    at_rest: f64,
}

impl Wrinkle {
    const ELBOW: Self = Self {
        extent: 0.095,
        across: 0.2,
        spacing: 0.055,
        height: 0.0125,
        stretch: 0.003,
        at_rest: 0.15,
    };
    const SHOULDER: Self = Self {
        extent: 0.13,
        across: 0.2,
        spacing: 0.068,
        height: 0.0115,
        stretch: 0.003,
        at_rest: 0.25,
    };
    const WAIST: Self = Self {
        extent: 0.17,
        across: 0.5,
        spacing: 0.078,
        height: 0.0145,
        stretch: 0.005,
        at_rest: 0.05,
    };
    const HIP: Self = Self {
        extent: 0.11,
        across: 0.2,
        spacing: 0.062,
        height: 0.015,
        stretch: 0.003,
        at_rest: 0.05,
    };
    const KNEE: Self = Self {
        extent: 0.11,
        across: 0.25,
        spacing: 0.062,
        height: 0.0155,
        stretch: 0.004,
        at_rest: 0.1,
    };
}

/// Normal displacement by the folds of a bent or twisted joint, metres.
fn wrinkles(site: &VertexSite, bend: &JointBend, shape: Wrinkle, phase: f64) -> f64 {
    let from = site.position - bend.centre;
    let along = from.dot(bend.axis);
    let across = from - bend.axis * along;
    let near = (-(along / shape.extent).powi(2) - (across.length() / shape.across).powi(4)).exp();
    if near < 1e-3 {
        return 0.0;
    }
    let toward = across.normalize_or_zero().dot(bend.inside);
    let bent = smooth((bend.angle - shape.at_rest) / 1.7);
    let turned = smooth((bend.twist.abs() - 0.1) / 1.2);
    // Folds run across the inside of a bend and become denser as it closes; twist slants them.
    let side = bend.axis.cross(bend.inside);
    let slant = if side == DVec3::ZERO { 0.0 } else { across.dot(side) };
    let crowd = std::f64::consts::TAU / shape.spacing;
    // Folds do not run all the way around: their phase and height vary.
    let around = across.dot(side).atan2(across.dot(bend.inside));
    let wander = 1.1 * (2.0 * around + phase).sin();
    let swell = 0.65 + 0.35 * (3.0 * around + 2.0 * phase + along * crowd * 0.5).sin();
    let folded = swell
        * ridge(
            along * crowd * (1.0 + 0.22 * bent)
                + (7.0 * bend.twist.clamp(-1.5, 1.5)) * slant
                + wander
                + phase
                + 2.6 * bend.angle,
        );
    let inside = 0.18 + 0.82 * smooth(0.35 + 0.75 * toward);
    let fold = shape.height * (bent * inside + 0.45 * turned) * (folded + 0.12);
    near * (fold - shape.stretch * bent * smooth(-toward))
}

/// Periodic wave with sharp crests and flat troughs, of mean 0 and range 2.
fn ridge(phase: f64) -> f64 {
    let wave = 0.5 + 0.5 * phase.sin();
    2.0 * wave * wave - 0.75
}

/// Smooth bump: 1 at 0, 0 at ±1.
fn bump(x: f64) -> f64 {
    smooth(1.0 - x.abs())
}

/// Smooth step: 0 at 0, 1 at 1.
fn smooth(x: f64) -> f64 {
    let x = x.clamp(0.0, 1.0);
    x * x * (3.0 - 2.0 * x)
}

fn mix(a: f64, b: f64, t: f64) -> f64 {
    a + (b - a) * t
}
