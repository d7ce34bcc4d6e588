//! Choice among keypoint layouts of the same number of points.

use super::{Keypoint, KeypointLayout};

/// Pairs of SMPL's joints and their typical distance, metres.
const BONES: [(usize, usize, f64); 12] = [
    (16, 18, 0.26),
    (18, 20, 0.25),
    (17, 19, 0.26),
    (19, 21, 0.25),
    (1, 4, 0.38),
    (4, 7, 0.40),
    (2, 5, 0.38),
    (5, 8, 0.40),
    (16, 17, 0.35),
    (1, 2, 0.20),
    (16, 1, 0.47),
    (17, 2, 0.47),
];
/// Fewest bones that layouts are compared by.
const FEWEST: usize = 5;
/// Factor on the lengths of a body whose shoulders are below its hips.
const UPSIDE_DOWN: f64 = 1.25;
/// Largest ratio of the lengths of two layouts that decides between them.
const DECISIVE: f64 = 0.95;

/// A layout, and the reason for it where the number of points allows several.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LayoutChoice {
    pub(super) layout: KeypointLayout,
    pub(super) note: Option<String>,
}

/// The layout in which the points are the most plausible person, that is, whose longest bone for
/// its typical length is the shortest; `None` if no layout has this number of points.
pub(super) fn choose_layout(people: &[&[Keypoint]], count: usize) -> Option<LayoutChoice> {
    let usual = KeypointLayout::of_count(count).next()?;
    let mean = |layout| {
        let lengths: Vec<f64> =
            people.iter().filter_map(|points| relative_length(layout, points)).collect();
        (!lengths.is_empty()).then(|| lengths.iter().sum::<f64>() / lengths.len() as f64)
    };
    let mut found: Vec<(KeypointLayout, f64)> =
        KeypointLayout::of_count(count).filter_map(|l| Some((l, mean(l)?))).collect();
    found.sort_by(|a, b| a.1.total_cmp(&b.1));
    Some(match found.as_slice() {
        [(best, length), (other, longer), ..] => {
            let clear = *length <= DECISIVE * longer;
            let layout = if clear { *best } else { usual };
            let by = if clear { "by the lengths of limbs" } else { "undecided" };
            let other = if layout == *best { other } else { best };
            let note = (!clear || layout != usual).then(|| {
                format!(
                    "{count} points are taken as {layout}, not {other} ({by}): --layout chooses"
                )
            });
            LayoutChoice { layout, note }
        }
        _ => LayoutChoice { layout: usual, note: None },
    })
}

/// Largest length of a detected bone in the image divided by its typical length; `None` for too few
/// bones.
fn relative_length(layout: KeypointLayout, points: &[Keypoint]) -> Option<f64> {
    let find = |joint: usize| {
        let (point, _) = layout.joints().iter().find(|&&(_, j)| j == joint)?;
        points.get(*point).filter(|point| point.confidence > 0.0)
    };
    let length = |&(a, b, length): &(usize, usize, f64)| {
        let (a, b) = (find(a)?, find(b)?);
        Some((a.x - b.x).hypot(a.y - b.y) / length)
    };
    let lengths: Vec<f64> = BONES.iter().filter_map(length).collect();
    if lengths.len() < FEWEST {
        return None;
    }
    let longest = lengths.iter().copied().fold(0.0, f64::max);
    let height = |[a, b]: [usize; 2]| Some(find(a)?.y + find(b)?.y);
    let upside_down = matches!((height([16, 17]), height([1, 2])), (Some(s), Some(h)) if s > h);
    Some(if upside_down { longest * UPSIDE_DOWN } else { longest })
}

#[cfg(test)]
mod tests {
    use cape_synth::{Motion, MotionStyle};

    use super::*;
    use crate::{PinholeCamera, Skeleton, testing::BODY};

    /// Points of a layout; those without a joint are near the head.
    fn seen(layout: KeypointLayout, motion: Motion, time: f64, yaw: f64) -> Vec<Keypoint> {
        let camera = PinholeCamera::new(512, 512, None).unwrap();
        let skeleton = Skeleton::new(&BODY).unwrap();
        let mut pose = motion.pose(&MotionStyle::default(), time).to_vec();
        pose[1] += yaw;
        let posed = skeleton.pose(&[], &pose, glam::DVec3::new(0.1, 0.2, -3.5)).unwrap();
        let at = |joint: usize| {
            let at = camera.project(posed.joints()[joint]);
            Keypoint { x: at.x, y: at.y, confidence: 0.9 }
        };
        let mut points = vec![at(15); layout.points()];
        for &(point, joint) in layout.joints() {
            points[point] = at(joint);
        }
        points
    }

    #[test]
    fn orders_of_the_same_count_are_told_apart() {
        for layout in KeypointLayout::ALL {
            let others = KeypointLayout::of_count(layout.points()).count();
            let (mut right, mut all) = (0, 0);
            for motion in Motion::CAPTURED {
                for frame in 0..6 {
                    let time = 0.4 * f64::from(frame);
                    let points = seen(layout, motion, time, f64::from(frame));
                    let choice = choose_layout(&[&points], layout.points()).unwrap();
                    all += 1;
                    right += usize::from(choice.layout == layout);
                    assert!(others > 1 || choice.note.is_none());
                }
            }
            assert!(10 * right >= 9 * all, "{layout}: {right} of {all}");
        }
        // Nothing is seen.
        let nothing = vec![Keypoint::UNSEEN; 17];
        let choice = choose_layout(&[&nothing], 17).unwrap();
        assert_eq!(choice, LayoutChoice { layout: KeypointLayout::Coco17, note: None });
        assert_eq!(choose_layout(&[], 21), None);
    }
}
