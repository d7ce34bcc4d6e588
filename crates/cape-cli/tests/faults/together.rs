//! Two processes with one output.

use crate::{
    job::{Bench, quick_jobs},
    support::Ran,
};

#[test]
fn of_two_processes_one_is_refused_or_both_share_the_work() {
    for job in quick_jobs() {
        let bench = Bench::new(job);
        let [one, other] = [bench.start(), bench.start()];
        let ends = [one, other].map(|child| Ran::from(child.wait_with_output().unwrap()));
        for ran in &ends {
            let refused = ["another process", "already exists", "not empty"];
            assert!(!ran.err.contains("panicked"), "{}: {}", job.name, ran.err);
            assert!(
                ran.code == Some(0) || refused.iter().any(|said| ran.err.contains(said)),
                "{}: {:?} {}",
                job.name,
                ran.code,
                ran.err
            );
        }
        assert!(ends.iter().any(|ran| ran.code == Some(0)), "{}: {}", job.name, ends[0].err);
        bench.assert_as_expected("two at once");
    }
}
