//! Offsets of hanging cloth, which bridges concave parts of the body: it hangs from chest, shoulder
//! blades, seat and thighs instead of following waist, spine and calves.

use std::f64::consts::TAU;

use glam::DVec3;

use crate::regions::{LimbSite, Regions, VertexSite, joint};

/// Number of sampled directions around a tube.
const DIRECTIONS: usize = 32;
/// Distance between cross-sections, metres.
const STEP: f64 = 0.015;
/// Largest distance of bridging cloth from the skin, metres.
const MAX_GAP: f64 = 0.06;

/// Offset from a vertex to straight-hanging cloth, metres, for each garment part that may cover it.
#[derive(Debug, Clone, Copy)]
pub(super) struct DrapeOffsets {
    pub(super) body: DVec3,
    pub(super) sleeve: DVec3,
    pub(super) leg: DVec3,
}

/// Convex hulls of the cross-sections of a body part, whose width decreases downwards by at most a
/// given taper.
struct ConvexTube {
    first: f64,
    /// Distance from the axis by direction, metres, `[sections][DIRECTIONS]`.
    radius: Vec<[f64; DIRECTIONS]>,
}

impl ConvexTube {
    /// Builds the tube of `points` (distance along the axis, distance from it, angle around it) over a
    /// range along the axis. The width decreases by at most `taper` metres per metre.
    fn new(points: &[[f64; 3]], [first, last]: [f64; 2], taper: f64) -> Self {
        let sections = ((last - first) / STEP).ceil().max(1.0) as usize;
        let angle = |direction: usize| direction as f64 / DIRECTIONS as f64 * TAU;
        let mut support = [0.0; DIRECTIONS];
        let radius = (0..sections)
            .map(|section| {
                let at = first + section as f64 * STEP;
                for value in &mut support {
                    *value -= taper * STEP;
                }
                for &[along, radius, around] in points {
                    if (along - at).abs() < STEP {
                        for (direction, value) in support.iter_mut().enumerate() {
                            *value = value.max(radius * (around - angle(direction)).cos());
                        }
                    }
                }
                std::array::from_fn(|towards| {
                    let bound = |direction: usize| {
                        let cos = (angle(direction) - angle(towards)).cos();
                        if cos > 0.1 { support[direction] / cos } else { f64::INFINITY }
                    };
                    (0..DIRECTIONS).map(bound).fold(f64::INFINITY, f64::min)
                })
            })
            .collect();
        Self { first, radius }
    }

    /// Interpolated distance from the axis, metres; `None` before the first section.
    fn radius(&self, along: f64, around: f64) -> Option<f64> {
        let row = (along - self.first) / STEP;
        if row < 0.0 {
            return None;
        }
        let last = self.radius.len() - 1;
        let row = row.min(last as f64);
        let (low, high) = (row as usize, (row as usize + 1).min(last));
        let column = around.rem_euclid(TAU) / TAU * DIRECTIONS as f64;
        let (left, fraction) = (column as usize % DIRECTIONS, column.fract());
        let right = (left + 1) % DIRECTIONS;
        let at = |row: usize| {
            self.radius[row][left] * (1.0 - fraction) + self.radius[row][right] * fraction
        };
        Some(at(low) * (1.0 - row.fract()) + at(high) * row.fract())
    }
}

/// Drape offsets of all vertices.
pub(super) fn drape_offsets(regions: &Regions) -> Vec<DrapeOffsets> {
    let Regions { sites, joints } = regions;
    let chest = joints[joint::SHOULDERS[0]].y.min(joints[joint::SHOULDERS[1]].y) - 0.06;
    let bottom = joints[joint::HIPS[0]].y - 0.12;
    let trunk = |site: &VertexSite| {
        let from = site.position - joints[joint::SPINE[0]];
        [chest - site.position.y, from.x.hypot(from.z), from.x.atan2(from.z)]
    };
    let in_trunk = sites.iter().filter(|site| {
        site.arm_weight < 0.35 && site.position.y > bottom && site.position.y < chest + STEP
    });
    let body =
        ConvexTube::new(&in_trunk.map(trunk).collect::<Vec<_>>(), [0.0, chest - bottom], 0.10);

    let limb = |limb: &LimbSite| [limb.along * limb.length, limb.radius, limb.angle];
    let tubes = |of: fn(&VertexSite) -> &LimbSite,
                 weight: fn(&VertexSite) -> f64,
                 start: f64,
                 taper: f64| {
        [0, 1].map(|side| {
            let part: Vec<_> = sites
                .iter()
                .filter(|site| site.side == side && weight(site) > 0.6 && site.clothed)
                .map(|site| limb(of(site)))
                .collect();
            let end = part.iter().map(|p| p[0]).fold(start, f64::max);
            ConvexTube::new(&part, [start, end], taper)
        })
    };
    let sleeves = tubes(|site| &site.arm, |site| site.arm_weight, 0.05, 0.07);
    let legs = tubes(|site| &site.leg, |site| site.leg_weight, 0.12, 0.055);

    let gap = |tube: &ConvexTube, [along, radius, around]: [f64; 3]| {
        tube.radius(along, around).map_or(0.0, |hull| (hull - radius).clamp(0.0, MAX_GAP))
    };
    sites
        .iter()
        .map(|site| {
            let [_, _, around] = trunk(site);
            let outward = DVec3::new(around.sin(), 0.0, around.cos());
            DrapeOffsets {
                body: outward * gap(&body, trunk(site)),
                sleeve: site.arm.radial * gap(&sleeves[site.side], limb(&site.arm)),
                leg: site.leg.radial * gap(&legs[site.side], limb(&site.leg)),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tube_is_the_convex_hull_and_narrows_by_its_taper() {
        // A square cross-section of half-width 1 at the top, a thin rod below.
        let mut points = Vec::new();
        for i in 0..400 {
            let t = f64::from(i % 100) / 50.0 - 1.0;
            let (x, y) = [(t, 1.0), (1.0, t), (t, -1.0), (-1.0, t)][i as usize / 100];
            // Concave parts of the sides do not change the hull.
            let dent = if t.abs() < 0.5 { 0.7 } else { 1.0 };
            points.push([0.0, x.hypot(y) * dent, x.atan2(y)]);
        }
        points.push([1.0, 0.1, 0.0]);
        let tube = ConvexTube::new(&points, [0.0, 1.0], 0.2);
        assert!((tube.radius(0.0, 0.0).unwrap() - 1.0).abs() < 0.01);
        assert!((tube.radius(0.0, TAU / 8.0).unwrap() - 2_f64.sqrt()).abs() < 0.02);
        let lower = tube.radius(0.75, 0.0).unwrap();
        assert!((lower - (1.0 - 0.2 * 0.75)).abs() < 0.02, "{lower}");
        assert_eq!(tube.radius(-0.1, 0.0), None);
    }
}
