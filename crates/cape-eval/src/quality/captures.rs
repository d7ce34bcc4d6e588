//! Halves of the held-out captures, for measures of samples that real captures are measured by, too.

use std::collections::{BTreeMap, HashMap};

use cape_core::Outfit;
use cape_data::PackedSet;

use super::sets::{ClothingSet, SetDistances, SetQuality};

/// Captures of the held-out frames, and two halves of them.
pub(super) struct HeldOutCaptures {
    /// Number of the capture of each frame.
    pub(super) of: Vec<usize>,
    /// True for the captures of the second half.
    second: Vec<bool>,
}

impl HeldOutCaptures {
    /// Captures of the `rows` of a set; each frame is one of its own if they are unknown. The only capture
    /// of an outfit is divided in the middle, as if it were two.
    pub(super) fn of(set: &PackedSet, rows: &[usize]) -> Self {
        let name = |&row: &usize| set.capture(row).unwrap_or_else(|| row.to_string());
        Self::new(rows.iter().map(|row| (set.outfits()[*row], name(row))))
    }

    /// Captures of frames with these outfits and names of captures.
    fn new(frames: impl Iterator<Item = (Outfit, String)>) -> Self {
        let mut numbers: HashMap<String, usize> = HashMap::new();
        let mut worn: Vec<Outfit> = Vec::new();
        let number = |(outfit, name): (Outfit, String)| {
            *numbers.entry(name).or_insert_with(|| {
                worn.push(outfit);
                worn.len() - 1
            })
        };
        let mut of: Vec<usize> = frames.map(number).collect();
        for capture in 0..worn.len() {
            if worn.iter().filter(|outfit| **outfit == worn[capture]).count() == 1 {
                let own: Vec<usize> = (0..of.len()).filter(|&frame| of[frame] == capture).collect();
                for &frame in &own[own.len().div_ceil(2)..] {
                    of[frame] = worn.len();
                }
                worn.push(worn[capture]);
            }
        }
        Self { of, second: second_half(&worn) }
    }

    /// Measures of the samples in the poses of one half against the frames of the other, mean over both
    /// halves; `samples` are in the order of `frames`, and can be the frames themselves.
    pub(super) fn compare(
        &self,
        frames: &[Vec<[f32; 3]>],
        samples: &[Vec<[f32; 3]>],
    ) -> SetQuality {
        let set = |points: &[Vec<[f32; 3]>]| ClothingSet {
            points: points.to_vec(),
            captures: self.of.clone(),
        };
        let (frames, samples) = (set(frames), set(samples));
        let mut sum = SetQuality::default();
        for second in [false, true] {
            let own = frames.of_captures(|capture| self.second[capture] == second);
            let other = samples.of_captures(|capture| self.second[capture] != second);
            let quality = SetDistances::between(&own, &other).quality();
            sum.coverage += 0.5 * quality.coverage;
            sum.minimum_matching_mm += 0.5 * quality.minimum_matching_mm;
            sum.nearest_neighbour_accuracy += 0.5 * quality.nearest_neighbour_accuracy;
        }
        sum
    }
}

/// Halves of the captures of each outfit. The first, fourth, fifth, eighth and so on of an outfit are the
/// first half, so that subjects and sequences, by which captures are ordered, are mixed.
fn second_half(worn: &[Outfit]) -> Vec<bool> {
    let mut seen: BTreeMap<Outfit, usize> = BTreeMap::new();
    let half = |outfit: &Outfit| {
        let place = seen.entry(*outfit).or_default();
        *place += 1;
        matches!(*place % 4, 2 | 3)
    };
    worn.iter().map(half).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_have_as_many_captures_of_each_outfit() {
        let worn = [Outfit::LONG_LONG, Outfit::SHORT_LONG].repeat(4);
        let second = second_half(&worn);
        assert_eq!(second, [false, false, true, true, true, true, false, false]);
    }

    #[test]
    fn the_only_capture_of_an_outfit_is_divided() {
        let names = ["a", "a", "b", "b", "b", "c"];
        let outfits = [Outfit::LONG_LONG, Outfit::SHORT_LONG, Outfit::LONG_LONG];
        let frames =
            names.map(|name| (outfits[(name.as_bytes()[0] - b'a') as usize], name.to_owned()));
        let captures = HeldOutCaptures::new(frames.into_iter());
        assert_eq!(captures.of, [0, 0, 1, 1, 3, 2]);
        assert_eq!(captures.second, [false, false, true, true]);
    }

    /// Captures of ten near frames on a line, of which every second is of the other half.
    #[test]
    fn samples_like_the_frames_are_measured_as_they_are() {
        let frames: Vec<Vec<[f32; 3]>> = (0..80)
            .map(|i| vec![[(i / 10) as f32 * 0.01 + (i % 10) as f32 * 0.0001, 0.0, 0.0]])
            .collect();
        let captures = HeldOutCaptures {
            of: (0..80).map(|i| i / 10).collect(),
            second: second_half(&[Outfit::LONG_LONG; 8]),
        };
        let own = captures.compare(&frames, &frames);
        let far: Vec<_> =
            frames.iter().map(|points| vec![[points[0][0] + 9.0, 0.0, 0.0]]).collect();
        let other = captures.compare(&frames, &far);
        assert!(own.nearest_neighbour_accuracy < 0.6, "{own:?}");
        assert!(own.minimum_matching_mm < 11.0, "{own:?}");
        assert_eq!(other.nearest_neighbour_accuracy, 1.0);
        assert!(other.coverage <= 1.0 / 40.0, "{other:?}");
    }
}
