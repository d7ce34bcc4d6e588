use cape_synth::Motion;

use crate::{LayerSet, Sequence};

/// A property in which the sequences of a set differ, and which can be held out.
///
/// ```
/// # include!(concat!(env!("CARGO_MANIFEST_DIR"), "/doc/sets.rs"));
/// # fn main() -> Result<(), Box<dyn std::error::Error>> {
/// use cape_synth::synthetic_body;
/// use cape_layer::{LayerSet, Sequence, experiment::Factor};
///
/// // The same patch in two sequences with the names of different motions.
/// let march = patch(&synthetic_body())?.0.sequences.remove(0);
/// let walk = Sequence { name: "anna_walk".into(), ..march.clone() };
/// let set = LayerSet::new(vec![[0, 1, 2]], vec![march, walk])?;
/// let groups = Factor::Motion.groups(&set);
/// assert_eq!(groups.len(), 2);
/// assert_eq!((groups[1].label.as_str(), groups[1].sequences.as_slice()), ("walk", &[1][..]));
/// assert_eq!(Factor::Shape.groups(&set).len(), 1);
/// # Ok(())
/// # }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum Factor {
    /// Shape coefficients of the body.
    Shape,
    /// Motion: the part of a sequence's name after the last `_`.
    Motion,
    /// Material: semantic parameters other than garment sizes.
    Material,
    /// Garment size: semantic parameters named length, width, sleeve or size.
    Fit,
}

/// Sequences with one value of a factor.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SequenceGroup {
    /// Value of the factor, as text.
    pub label: String,
    /// Indices of the sequences in the set, ascending.
    pub sequences: Vec<usize>,
}

/// Number of training motions from which on a test split is held out, instead of each motion in turn.
const MANY_MOTIONS: usize = 10;

const SIZES: [&str; 4] = ["length", "width", "sleeve", "size"];

impl Factor {
    /// All factors.
    pub const ALL: [Self; 4] = [Self::Shape, Self::Motion, Self::Material, Self::Fit];

    /// Name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Shape => "shape",
            Self::Motion => "motion",
            Self::Material => "material",
            Self::Fit => "fit",
        }
    }

    /// Sequences of the set by the value of this factor, in order of first occurrence; one group if
    /// they do not differ.
    pub fn groups(self, set: &LayerSet) -> Vec<SequenceGroup> {
        let mut groups: Vec<SequenceGroup> = Vec::new();
        for (index, sequence) in set.sequences.iter().enumerate() {
            let label = self.label(set, sequence);
            match groups.iter_mut().find(|group| group.label == label) {
                Some(group) => group.sequences.push(index),
                None => groups.push(SequenceGroup { label, sequences: vec![index] }),
            }
        }
        groups
    }

    /// Groups that are held out in turn: those of [`groups`](Self::groups), but of more than ten motions
    /// those of the test split of synthetic captures together.
    pub fn held_out_groups(self, set: &LayerSet) -> Vec<SequenceGroup> {
        let groups = self.groups(set);
        let test = Motion::TEST.map(|motion| motion.name().replace('_', "-"));
        let (held, known): (Vec<_>, Vec<_>) =
            groups.iter().cloned().partition(|group| test.contains(&group.label));
        if self != Self::Motion || known.len() < MANY_MOTIONS || held.is_empty() {
            return groups;
        }
        let labels: Vec<&str> = held.iter().map(|group| group.label.as_str()).collect();
        let mut sequences: Vec<usize> = held.iter().flat_map(|g| g.sequences.clone()).collect();
        sequences.sort_unstable();
        vec![SequenceGroup { label: labels.join(", "), sequences }]
    }

    fn label(self, set: &LayerSet, sequence: &Sequence) -> String {
        let numbers = |wanted: &dyn Fn(&str) -> bool| {
            let differs = |at: usize, value: f64| {
                set.sequences.iter().any(|other| other.parameters[at].1 != value)
            };
            let parameters = sequence.parameters.iter().enumerate();
            let told =
                parameters.filter(|(at, (name, value))| wanted(name) && differs(*at, *value));
            told.map(|(_, (name, value))| format!("{name} {value:.3}"))
                .collect::<Vec<_>>()
                .join(", ")
        };
        match self {
            Self::Shape => {
                let betas: Vec<String> = sequence.betas.iter().map(|b| format!("{b:.2}")).collect();
                if betas.is_empty() {
                    "mean shape".into()
                } else {
                    format!("β {}", betas.join(" "))
                }
            }
            Self::Motion => {
                let name = &sequence.name;
                name.rsplit_once('_').map_or(name.as_str(), |(_, last)| last).to_owned()
            }
            Self::Material => numbers(&|name| !SIZES.contains(&name)),
            Self::Fit => numbers(&|name| SIZES.contains(&name)),
        }
    }
}

#[cfg(test)]
mod tests {
    use ndarray::{Array2, Array3};

    use super::*;
    use cape_core::BodyMotion;

    #[test]
    fn sequences_are_grouped_by_what_differs() {
        let sequence = |name: &str, beta: f64, length: f64| Sequence {
            name: name.into(),
            clothing: Array3::zeros((1, 3, 3)),
            betas: vec![beta],
            motion: BodyMotion::new(30.0, Array2::zeros((1, 72)), Array2::zeros((1, 3))).unwrap(),
            parameters: vec![
                ("length".into(), length),
                ("width".into(), 1.0),
                ("log_rigidity".into(), -2.0),
            ],
        };
        let sequences = vec![
            sequence("a_walk", 0.0, 1.0),
            sequence("b_jump", 0.0, 1.2),
            sequence("c_walk", 1.0, 1.0),
        ];
        let set = LayerSet::new(vec![[0, 1, 2]], sequences).unwrap();
        let groups = |factor: Factor| -> Vec<(String, Vec<usize>)> {
            factor.groups(&set).into_iter().map(|g| (g.label, g.sequences)).collect()
        };
        assert_eq!(groups(Factor::Motion), [("walk".into(), vec![0, 2]), ("jump".into(), vec![1])]);
        assert_eq!(groups(Factor::Shape)[1], ("β 1.00".into(), vec![2]));
        assert_eq!(groups(Factor::Fit)[1], ("length 1.200".into(), vec![1]));
        assert_eq!(groups(Factor::Material).len(), 1);
        assert_eq!(Factor::Motion.held_out_groups(&set).len(), 2, "each in turn");
    }

    #[test]
    fn of_many_motions_the_test_split_is_held_out() {
        let sequences = crate::synth::Exercise::styled(2).into_iter().map(|exercise| Sequence {
            name: format!("s00_{}", exercise.name()),
            clothing: Array3::zeros((1, 3, 3)),
            betas: vec![],
            motion: BodyMotion::new(30.0, Array2::zeros((1, 72)), Array2::zeros((1, 3))).unwrap(),
            parameters: vec![],
        });
        let set = LayerSet::new(vec![[0, 1, 2]], sequences.collect()).unwrap();
        assert_eq!(Factor::Motion.groups(&set).len(), 15);
        let held = Factor::Motion.held_out_groups(&set);
        assert_eq!(held.len(), 1);
        assert_eq!(held[0].label, "bend-twist, soccer, pose-model");
        assert_eq!(held[0].sequences, [24, 25, 26, 27, 28, 29]);
    }
}
