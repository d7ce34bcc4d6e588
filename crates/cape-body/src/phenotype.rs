//! Phenotypes: MakeHuman's macro parameters and the targets that they blend.

use std::collections::{BTreeMap, btree_map::Entry};

use glam::DVec3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use crate::{Assets, Gender, Result, assets::Target};

/// Number of targets that vary alone.
const LOCAL: usize = 9;
/// Those targets, `-decr` and `-incr`, and their standard deviation.
const LOCAL_TARGETS: [(&[&str], f64); LOCAL] = [
    (&["legs/upperlegs-height", "legs/lowerlegs-height"], 0.12),
    (&["arms/measure-upperarm-length", "arms/measure-lowerarm-length"], 0.15),
    (&["torso/measure-shoulder-dist"], 0.25),
    (&["torso/torso-scale-horiz"], 0.25),
    (&["hip/hip-scale-horiz"], 0.35),
    (&["torso/torso-scale-depth"], 0.25),
    (&["stomach/stomach-tone"], 0.40),
    (&["buttocks/buttocks-volume"], 0.40),
    (&["neck/neck-scale-vert"], 0.25),
];
/// Positions of targets with a mean other than 0.
const ARM_LENGTH: usize = 1;
const SHOULDER_BREADTH: usize = 2;

/// MakeHuman's macro parameters, 0 to 1, and the coefficients of the local targets, −1 to 1.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Phenotype {
    gender: f64,
    age: f64,
    muscle: f64,
    weight: f64,
    height: f64,
    proportions: f64,
    cup: f64,
    firmness: f64,
    /// African, Asian, European; they sum to 1.
    ancestry: [f64; 3],
    local: [f64; LOCAL],
}

/// Means of parameters that differ between the genders. They bring stature, span and volume of the mean
/// bodies near the means of adults.
struct Means {
    stature: f64,
    weight: f64,
    local: [f64; LOCAL],
}

impl Means {
    /// Means of women for `sex` 0, of men for 1, and between them.
    fn of(sex: f64) -> Self {
        let between = |woman: f64, man: f64| woman + sex * (man - woman);
        let mut local = [0.0; LOCAL];
        local[ARM_LENGTH] = between(0.3, 0.07);
        local[SHOULDER_BREADTH] = between(0.2, 0.05);
        Self { stature: between(0.60, 0.38), weight: between(0.87, 0.77), local }
    }
}

impl Phenotype {
    /// Draws `count` adults. Stature and weight follow the spread among adults, weight a little beyond
    /// MakeHuman's range; all other parameters are normal about MakeHuman's average.
    pub(crate) fn sample(gender: Gender, count: usize, seed: u64) -> Vec<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count)
            .map(|_| {
                let mut normal = |mean: f64, deviation: f64, low: f64, high: f64| {
                    (mean + deviation * rng.sample::<f64, _>(StandardNormal)).clamp(low, high)
                };
                let sex = match gender {
                    Gender::Male => 1.0,
                    Gender::Female => 0.0,
                    Gender::Neutral => normal(0.5, 0.25, 0.0, 1.0),
                };
                let means = Means::of(sex);
                // A unit of height is 0.73 m below MakeHuman's average, 1.45 m above.
                let stature: f64 = normal(means.stature, 1.0, -3.0, 3.5);
                let ancestry = [
                    normal(1.0, 0.5, 0.1, 2.0),
                    normal(1.0, 0.5, 0.1, 2.0),
                    normal(1.0, 0.5, 0.1, 2.0),
                ];
                let sum: f64 = ancestry.iter().sum();
                Self {
                    gender: sex,
                    age: 0.5 + normal(0.0, 0.2, -0.4, 0.4).abs(),
                    muscle: normal(0.55, 0.22, 0.0, 1.0),
                    weight: normal(means.weight, 0.36, -0.1, 1.4),
                    height: 0.5 + stature * if stature < 0.0 { 0.090 } else { 0.0455 },
                    proportions: normal(0.55, 0.2, 0.0, 1.0),
                    cup: normal(0.5, 0.2, 0.0, 1.0),
                    firmness: normal(0.5, 0.2, 0.0, 1.0),
                    ancestry: ancestry.map(|share| share / sum),
                    local: std::array::from_fn(|i| {
                        normal(means.local[i], LOCAL_TARGETS[i].1, -1.0, 1.0)
                    }),
                }
            })
            .collect()
    }

    /// Names of the targets and their factors; zero factors are left out.
    fn terms(&self) -> Vec<(String, f64)> {
        let mut terms = Vec::new();
        let halves = |x: f64, names: [&'static str; 3]| {
            let t = 2.0 * x - 1.0;
            [(names[0], (-t).max(0.0)), (names[1], 1.0 - t.abs()), (names[2], t.max(0.0))]
        };
        let muscles = halves(self.muscle, ["minmuscle", "averagemuscle", "maxmuscle"]);
        let weights = halves(self.weight, ["minweight", "averageweight", "maxweight"]);
        let heights = halves(self.height, ["minheight", "", "maxheight"]);
        let proportions = halves(self.proportions, ["uncommonproportions", "", "idealproportions"]);
        let cups = halves(self.cup, ["mincup", "averagecup", "maxcup"]);
        let firmnesses = halves(self.firmness, ["minfirmness", "averagefirmness", "maxfirmness"]);
        let old = 2.0 * self.age - 1.0;
        for (gender, sex) in [("female", 1.0 - self.gender), ("male", self.gender)] {
            for (age, years) in [("young", 1.0 - old), ("old", old)] {
                for (origin, share) in ["african", "asian", "caucasian"].iter().zip(self.ancestry) {
                    terms.push((
                        format!("macrodetails/{origin}-{gender}-{age}"),
                        sex * years * share,
                    ));
                }
                for (muscle, m) in muscles {
                    for (weight, w) in weights {
                        let factor = sex * years * m * w;
                        let who = format!("{gender}-{age}-{muscle}-{weight}");
                        terms.push((format!("macrodetails/universal-{who}"), factor));
                        for (height, h) in heights.into_iter().filter(|h| !h.0.is_empty()) {
                            terms.push((format!("macrodetails/height/{who}-{height}"), factor * h));
                        }
                        for (name, p) in proportions.into_iter().filter(|p| !p.0.is_empty()) {
                            terms.push((
                                format!("macrodetails/proportions/{who}-{name}"),
                                factor * p,
                            ));
                        }
                        for (cup, c) in cups {
                            for (firmness, f) in firmnesses {
                                // Average cup and firmness are those of the universal target.
                                if gender == "female"
                                    && (cup, firmness) != ("averagecup", "averagefirmness")
                                {
                                    terms.push((
                                        format!("breast/{who}-{cup}-{firmness}"),
                                        factor * c * f,
                                    ));
                                }
                            }
                        }
                    }
                }
            }
        }
        for ((names, _), value) in LOCAL_TARGETS.iter().zip(self.local) {
            let end = if value < 0.0 { "decr" } else { "incr" };
            terms.extend(names.iter().map(|name| (format!("{name}-{end}"), value.abs())));
        }
        terms.retain(|term| term.1 != 0.0);
        terms
    }
}

/// Targets by name.
#[derive(Default)]
pub(crate) struct Targets(BTreeMap<String, Target>);

impl Targets {
    /// Reads the targets of `phenotypes`.
    pub(crate) fn read(assets: &mut Assets, phenotypes: &[Phenotype]) -> Result<Self> {
        let mut targets = Self::default();
        for (name, _) in phenotypes.iter().flat_map(Phenotype::terms) {
            if let Entry::Vacant(entry) = targets.0.entry(name) {
                let target = assets.target(entry.key())?;
                entry.insert(target);
            }
        }
        Ok(targets)
    }

    /// Vertices of the base mesh with the phenotype's targets, metres.
    pub(crate) fn apply(&self, base: &[DVec3], phenotype: &Phenotype) -> Vec<DVec3> {
        let mut vertices = base.to_vec();
        for (name, factor) in phenotype.terms() {
            for &(vertex, moved) in self.0.get(&name).into_iter().flatten() {
                if let Some(position) = vertices.get_mut(vertex as usize) {
                    *position += moved * factor;
                }
            }
        }
        vertices.iter().map(|&p| p * 0.1).collect()
    }
}
