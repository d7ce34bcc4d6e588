//! Order and sides of the pairs that a rater sees.

use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng, seq::SliceRandom};
use serde::{Deserialize, Serialize};

use crate::{PairKind, StudyDesign};

/// Streams of the seed.
const PERMUTATION: u64 = 0;
const SIDES: u64 = 1;
const RATERS: u64 = 1 << 32;

/// A pair as a rater sees it.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Trial {
    /// Index of the pair.
    pub pair: usize,
    /// Picture on the left.
    pub left: String,
    /// Picture on the right.
    pub right: String,
}

impl StudyDesign {
    /// Trials of rater number `rater`: practice, then scored pairs with catch pairs among them.
    ///
    /// Raters take consecutive windows of one permutation of the pairs, so that the numbers of raters of
    /// two pairs differ by one at most. The sides of a pair alternate between two passes over the
    /// permutation, and within a pass from pair to pair.
    pub fn schedule(&self, rater: usize) -> Vec<Trial> {
        let mut permutation = self.of_kind(PairKind::Scored);
        permutation.shuffle(&mut self.stream(PERMUTATION));
        let count = permutation.len() as u64;
        let first = (rater as u64).wrapping_mul(self.trials as u64);
        let mut rng = self.stream(RATERS.wrapping_add(rater as u64));
        let mut trials: Vec<Trial> = (0..self.trials as u64)
            .map(|offset| {
                let place = first.wrapping_add(offset);
                let (pass, position) = (place / count, place % count);
                let mut sides = self.stream(SIDES.wrapping_add((pass / 2) << 1));
                let flip = sides.random_range(0..2u64);
                let real_left = (position + pass + flip).is_multiple_of(2);
                self.trial(permutation[position as usize], real_left)
            })
            .collect();
        trials.shuffle(&mut rng);
        let catches = self.of_kind(PairKind::Catch);
        let mut order = catches.clone();
        order.shuffle(&mut rng);
        // One in each of equal parts, from the last part on, so that places stay as they are.
        for (part, pair) in order.into_iter().enumerate().rev() {
            let bounds = [part, part + 1].map(|part| part * self.trials / catches.len());
            let place = rng.random_range(bounds[0]..=bounds[1]);
            let real_left = rng.random();
            trials.insert(place, self.trial(pair, real_left));
        }
        let practice = self.of_kind(PairKind::Practice).into_iter();
        practice.map(|pair| self.trial(pair, rng.random())).chain(trials).collect()
    }

    fn trial(&self, pair: usize, real_left: bool) -> Trial {
        let known = &self.pairs[pair];
        let (real, generated) = (known.real.file.clone(), known.generated.file.clone());
        let (left, right) = if real_left { (real, generated) } else { (generated, real) };
        Trial { pair, left, right }
    }

    fn stream(&self, stream: u64) -> ChaCha8Rng {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        rng.set_stream(stream);
        rng
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::*;
    use crate::simulation::tests::design;

    #[test]
    fn sides_and_pairs_are_balanced() {
        let design = design(30, 4, 2, 12);
        let (mut seen, mut real_left) = (BTreeMap::new(), BTreeMap::new());
        // Five raters make two passes.
        for rater in 0..10 {
            let trials = design.schedule(rater);
            let scored: Vec<_> = trials
                .iter()
                .filter(|trial| design.pairs[trial.pair].kind == PairKind::Scored)
                .collect();
            assert_eq!((scored.len(), trials.len()), (12, 18));
            let on_left =
                scored.iter().filter(|t| t.left == design.pairs[t.pair].real.file).count();
            assert!((5..=7).contains(&on_left), "{on_left} of 12 on the left");
            for trial in scored {
                *seen.entry(trial.pair).or_insert(0) += 1;
                let left = usize::from(trial.left == design.pairs[trial.pair].real.file);
                *real_left.entry(trial.pair).or_insert(0) += left;
            }
        }
        assert_eq!(seen.len(), 30);
        assert!(seen.values().all(|&count| count == 4), "{seen:?}");
        assert!(real_left.values().all(|&count| count == 2), "{real_left:?}");
    }

    #[test]
    fn schedules_depend_on_seed_and_rater_only() {
        let one = design(20, 3, 2, 20);
        assert_eq!(one.schedule(3), one.schedule(3));
        assert_ne!(one.schedule(3), one.schedule(4));
        let mut other = one.clone();
        other.seed += 1;
        assert_ne!(one.schedule(3), other.schedule(3));
    }

    #[test]
    fn practice_comes_first_and_catch_pairs_are_spread() {
        let design = design(40, 4, 2, 40);
        for rater in 0..20 {
            let kinds: Vec<_> =
                design.schedule(rater).iter().map(|trial| design.pairs[trial.pair].kind).collect();
            assert_eq!(kinds[..2], [PairKind::Practice; 2]);
            for part in 0..4 {
                let among = &kinds[2 + 11 * part..2 + 11 * (part + 1)];
                let catches = among.iter().filter(|&&kind| kind == PairKind::Catch).count();
                assert!((0..=2).contains(&catches), "{kinds:?}");
            }
            assert_eq!(kinds.iter().filter(|&&kind| kind == PairKind::Catch).count(), 4);
        }
    }
}
