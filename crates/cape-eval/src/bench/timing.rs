use std::time::{Duration, Instant};

use crate::Result;

/// Options of a timing.
#[derive(Debug, Clone, Copy)]
pub(crate) struct TimingOptions {
    /// Runs before the timed ones.
    pub warm_up: usize,
    /// Largest number of timed runs.
    pub most: usize,
    /// Smallest number of timed runs.
    pub least: usize,
    /// Time after which no further run starts.
    pub budget: Duration,
}

impl TimingOptions {
    /// Largest number of runs, including warm-up.
    pub(crate) fn runs(&self) -> usize {
        self.warm_up + self.most
    }

    /// Times `work`; `done` is called after every run.
    pub(crate) fn time(
        &self,
        mut work: impl FnMut() -> Result<()>,
        mut done: impl FnMut(),
    ) -> Result<Timing> {
        for _ in 0..self.warm_up {
            work()?;
            done();
        }
        let begin = Instant::now();
        let mut seconds = Vec::new();
        while seconds.len() < self.least
            || seconds.len() < self.most && begin.elapsed() < self.budget
        {
            let start = Instant::now();
            work()?;
            seconds.push(start.elapsed().as_secs_f64());
            done();
        }
        Ok(Timing { runs: seconds.len(), seconds: median(seconds) })
    }
}

/// Result of a timing.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Timing {
    /// Number of timed runs.
    pub runs: usize,
    /// Median time of a run, seconds.
    pub seconds: f64,
}

/// Median of at least one value.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    f64::midpoint(values[(values.len() - 1) / 2], values[values.len() / 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn medians_are_in_the_middle() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 2.0, 3.0]), 2.5);
    }

    #[test]
    fn the_budget_ends_runs_but_not_before_the_least() {
        let effort = |seconds| TimingOptions {
            warm_up: 2,
            most: 5,
            least: 3,
            budget: Duration::from_secs(seconds),
        };
        for (budget, runs) in [(0, 3), (3600, 5)] {
            let (mut worked, mut told) = (0, 0);
            let work = || {
                worked += 1;
                Ok(())
            };
            let timing = effort(budget).time(work, || told += 1).unwrap();
            assert_eq!([timing.runs, worked, told], [runs, runs + 2, runs + 2]);
        }
    }
}
