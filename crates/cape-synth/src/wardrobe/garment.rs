//! The state of one set of clothes: what differs between two takes of the same outfit.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use cape_core::Outfit;

/// Number of waves in a crumple pattern.
pub(super) const WAVES: usize = 14;

/// Number of waves in a registration's misfit, and the size of each: 0.6 mm an axis together.
const MISFIT_WAVES: usize = 8;
const MISFIT: f64 = 0.0003;

/// How one person wears one outfit in one sequence.
///
/// The clothes themselves, their cut and where they like to fold, are a person's own; how they were
/// put on differs from sequence to sequence. Constant over a sequence's frames and independent of
/// the pose. Lengths are metres, positions along limbs fractions of the limb.
///
/// See [`Wardrobe`](crate::Wardrobe) for an example.
#[derive(Debug, Clone)]
pub struct OutfitStyle {
    /// What is worn.
    pub outfit: Outfit,
    pub(super) seed: u64,
    pub(super) shirt: Shirt,
    pub(super) trousers: Trousers,
    pub(super) crumple: Vec<Wave>,
    /// Phase and speed of the sway.
    pub(super) sway: [f64; 2],
    /// How registrations of the wearer miss the minimal shape.
    misfit: Vec<Wave>,
}

/// The upper garment. Pairs are left and right.
#[derive(Debug, Clone)]
pub(super) struct Shirt {
    /// Ease of the body at the hem.
    pub(super) ease: f64,
    /// How far it hangs straight instead of following the body, 0 to 1.
    pub(super) drape: f64,
    /// Ease of the sleeves.
    pub(super) sleeve_ease: f64,
    /// Where the sleeves end.
    pub(super) sleeve_end: [f64; 2],
    /// Lowering of the collar.
    pub(super) collar: f64,
    /// Height of the hem above the hips.
    pub(super) hem: f64,
    /// Rise of the hem per metre to the left and to the front.
    pub(super) hem_slope: [f64; 2],
    /// Waviness of the hem, and its phase.
    pub(super) hem_wave: [f64; 2],
    /// Whether it is worn inside the trousers.
    pub(super) tucked: bool,
    /// How far the cloth is turned around the body, tangentially at the hem.
    pub(super) twist: f64,
    /// Turn of each sleeve around the arm, tangentially.
    pub(super) sleeve_twist: [f64; 2],
    /// Shift of each sleeve along the arm.
    pub(super) sleeve_slide: [f64; 2],
    /// Shift of the body upwards.
    pub(super) ride: f64,
    /// Shift of the hem to the left and to the front.
    pub(super) lean: [f64; 2],
    /// Vertical folds around the hem: number, phase, slant.
    pub(super) folds: [f64; 3],
    /// Second, coarser set of vertical folds.
    pub(super) gathers: [f64; 3],
    /// Phases of the sleeves' folds.
    pub(super) sleeve_phase: [f64; 2],
}

/// The lower garment. Pairs are left and right.
#[derive(Debug, Clone)]
pub(super) struct Trousers {
    /// Ease of the legs.
    pub(super) ease: f64,
    /// How far the legs hang straight instead of following the body, 0 to 1.
    pub(super) drape: f64,
    /// Growth of the ease towards the cuff.
    pub(super) flare: f64,
    /// Where the legs end.
    pub(super) leg_end: [f64; 2],
    /// Raising of the waistband.
    pub(super) waist: f64,
    /// Sagging of the seat.
    pub(super) seat: f64,
    /// Turn of each leg of the cloth around the leg, tangentially at the cuff.
    pub(super) twist: [f64; 2],
    /// Shift of each leg of the cloth along the leg.
    pub(super) slide: [f64; 2],
    /// Size and phases of the folds that stack above the cuffs.
    pub(super) stack: f64,
    pub(super) stack_phase: [f64; 2],
    /// Phases of the lengthwise folds.
    pub(super) fold_phase: [f64; 2],
}

/// One wave of the random pattern of dents.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wave {
    /// Radians per metre.
    pub(super) vector: DVec3,
    pub(super) phase: f64,
    pub(super) amplitude: f64,
    /// Direction in which the cloth shifts along the surface with the dent.
    pub(super) drag: DVec3,
    /// How far its phase follows the bending of the waist.
    pub(super) follow: f64,
}

impl OutfitStyle {
    pub(super) fn random(outfit: Outfit, seed: u64) -> Self {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let shirt = Shirt::random(outfit.long_sleeves(), rng);
        let trousers = Trousers::random(outfit.long_legs(), rng);
        let crumple = (0..WAVES).map(|_| Wave::random(rng)).collect();
        let sway = [rng.random_range(0.0..TAU), rng.random_range(0.5..1.1)];
        let misfit = (0..MISFIT_WAVES).map(|_| Wave::random_misfit(rng)).collect();
        Self { outfit, seed, shirt, trousers, crumple, sway, misfit }
    }

    /// These clothes, put on as `other` clothes are: what slips, turns and leans is taken from
    /// those, and folds move a little.
    pub(super) fn with_fit_of(self, other: Self) -> Self {
        let waves = self.crumple.into_iter().zip(&other.crumple);
        Self {
            outfit: self.outfit,
            seed: other.seed,
            shirt: self.shirt.with_fit_of(&other.shirt),
            trousers: self.trousers.with_fit_of(&other.trousers),
            crumple: waves
                .map(|(wave, other)| Wave {
                    phase: shift_phase(wave.phase, other.phase, 2.0 * NUDGE),
                    amplitude: 0.8 * wave.amplitude + 0.6 * other.amplitude,
                    ..wave
                })
                .collect(),
            sway: other.sway,
            misfit: self.misfit,
        }
    }

    /// How far a registration of the wearer is from the minimal shape without any clothes, metres.
    pub(super) fn misfit(&self, position: DVec3) -> DVec3 {
        let waves = self.misfit.iter();
        waves.map(|wave| wave.drag * (wave.vector.dot(position) + wave.phase).sin()).sum()
    }
}

/// How far folds move between sequences, as a share of half a turn.
const NUDGE: f64 = 0.12;

/// `phase` moved by up to `share` of half a turn, as the angle `other` says.
fn shift_phase(phase: f64, other: f64, share: f64) -> f64 {
    phase + share * (other - PI)
}

impl Shirt {
    fn random(long: bool, rng: &mut ChaCha8Rng) -> Self {
        let end = if long { 0.885 } else { 0.37 } + if long { 0.022 } else { 0.035 } * normal(rng);
        let uneven = if long { 0.012 } else { 0.01 } * normal(rng);
        let limit = if long { (0.8, 0.925) } else { (0.28, 0.46) };
        Self {
            ease: log_normal(0.009, 0.45, rng),
            drape: (0.38 + 0.3 * normal(rng)).clamp(0.0, 1.0),
            sleeve_ease: log_normal(if long { 0.006 } else { 0.009 }, 0.45, rng),
            sleeve_end: [end + uneven, end - uneven].map(|e: f64| e.clamp(limit.0, limit.1)),
            collar: 0.008 * normal(rng),
            hem: -0.015 + 0.022 * normal(rng),
            hem_slope: [0.07 * normal(rng), 0.1 * normal(rng)],
            hem_wave: [0.006 * normal(rng), angle(rng)],
            tucked: rng.random_bool(0.2),
            twist: 0.014 * normal(rng),
            sleeve_twist: pair(0.008, rng),
            sleeve_slide: pair(0.011, rng),
            ride: 0.009 * normal(rng),
            lean: pair(0.011, rng),
            folds: [f64::from(rng.random_range(6_u8..=8)), angle(rng), 0.9 * normal(rng)],
            gathers: [f64::from(rng.random_range(2_u8..=4)), angle(rng), 0.7 * normal(rng)],
            sleeve_phase: [angle(rng), angle(rng)],
        }
    }

    fn with_fit_of(self, other: &Self) -> Self {
        let moved = |[count, phase, slant]: [f64; 3], other: [f64; 3]| {
            [count, shift_phase(phase, other[1], NUDGE), slant + 0.3 * other[2]]
        };
        Self {
            hem_slope: [0, 1].map(|i| 0.7 * self.hem_slope[i] + 0.7 * other.hem_slope[i]),
            hem_wave: [self.hem_wave[0], shift_phase(self.hem_wave[1], other.hem_wave[1], NUDGE)],
            twist: other.twist,
            sleeve_twist: other.sleeve_twist,
            sleeve_slide: other.sleeve_slide,
            ride: other.ride,
            lean: other.lean,
            folds: moved(self.folds, other.folds),
            gathers: moved(self.gathers, other.gathers),
            sleeve_phase: [0, 1]
                .map(|i| shift_phase(self.sleeve_phase[i], other.sleeve_phase[i], NUDGE)),
            ..self
        }
    }
}

impl Trousers {
    fn random(long: bool, rng: &mut ChaCha8Rng) -> Self {
        let end = if long { 0.885 } else { 0.46 } + if long { 0.018 } else { 0.035 } * normal(rng);
        let uneven = 0.008 * normal(rng);
        let limit = if long { (0.82, 0.915) } else { (0.36, 0.56) };
        Self {
            ease: log_normal(if long { 0.006 } else { 0.008 }, 0.45, rng),
            drape: (0.33 + 0.3 * normal(rng)).clamp(0.0, 1.0),
            flare: if long { 0.7 } else { 1.1 } + 0.35 * normal(rng),
            leg_end: [end + uneven, end - uneven].map(|e: f64| e.clamp(limit.0, limit.1)),
            waist: 0.012 * normal(rng),
            seat: 0.006 + 0.006 * normal(rng).abs(),
            twist: pair(0.012, rng),
            slide: pair(0.013, rng),
            stack: if long { log_normal(0.004, 0.4, rng) } else { 0.0 },
            stack_phase: [angle(rng), angle(rng)],
            fold_phase: [angle(rng), angle(rng)],
        }
    }

    fn with_fit_of(self, other: &Self) -> Self {
        let moved =
            |own: [f64; 2], other: [f64; 2]| [0, 1].map(|i| shift_phase(own[i], other[i], NUDGE));
        Self {
            waist: 0.7 * self.waist + 0.7 * other.waist,
            twist: other.twist,
            slide: other.slide,
            stack_phase: moved(self.stack_phase, other.stack_phase),
            fold_phase: moved(self.fold_phase, other.fold_phase),
            ..self
        }
    }
}

impl Wave {
    fn random(rng: &mut ChaCha8Rng) -> Self {
        let length = rng.random_range(0.10..0.34);
        let direction = DVec3::from_array(std::array::from_fn(|_| normal(rng)));
        let drag = DVec3::from_array(std::array::from_fn(|_| normal(rng)));
        Self {
            vector: direction.normalize_or(DVec3::Y) * (TAU / length),
            phase: angle(rng),
            amplitude: 0.0012 * (length / 0.2_f64).sqrt() * normal(rng),
            drag: drag * 0.001,
            follow: 1.5 * normal(rng),
        }
    }
}

impl Wave {
    fn random_misfit(rng: &mut ChaCha8Rng) -> Self {
        let length = rng.random_range(0.15..0.6);
        let random = |rng: &mut ChaCha8Rng| DVec3::from_array(std::array::from_fn(|_| normal(rng)));
        Self {
            vector: random(rng).normalize_or(DVec3::Y) * (TAU / length),
            phase: angle(rng),
            amplitude: 0.0,
            drag: MISFIT * random(rng),
            follow: 0.0,
        }
    }
}

/// Standard normal, cut at ±2.2.
fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample::<f64, _>(StandardNormal).clamp(-2.2, 2.2)
}

fn log_normal(median: f64, spread: f64, rng: &mut ChaCha8Rng) -> f64 {
    median * (spread * normal(rng)).exp()
}

fn pair(spread: f64, rng: &mut ChaCha8Rng) -> [f64; 2] {
    let (common, own) = (normal(rng), [normal(rng), normal(rng)]);
    own.map(|own| spread * (0.5 * common + 0.866 * own))
}

fn angle(rng: &mut ChaCha8Rng) -> f64 {
    rng.random_range(0.0..TAU)
}
