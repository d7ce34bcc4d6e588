//! Parameters of the garments of one subject in one sequence.

use std::f64::consts::{PI, TAU};

use glam::DVec3;
use rand::{RngExt, SeedableRng, rngs::ChaCha8Rng};
use rand_distr::StandardNormal;

use cape_core::Outfit;

use super::GarmentLengths;

/// Number of waves of the crumple pattern.
pub(super) const WAVES: usize = 14;

/// Number of waves of the registration error.
const REGISTRATION_WAVES: usize = 8;
/// Amplitude of a wave of the registration error, metres; 0.6 mm per axis for all waves.
const REGISTRATION_AMPLITUDE: f64 = 0.0003;

/// Style of an outfit: the parameters of its garments on one subject in one sequence.
///
/// Cut and preferred folds belong to the subject; slip, twist and lean vary between sequences. All are
/// constant over the frames of a sequence and independent of the pose. Lengths are in metres,
/// positions along limbs in fractions of the limb.
#[derive(Debug, Clone)]
pub struct OutfitStyle {
    /// Outfit.
    pub outfit: Outfit,
    pub(super) lengths: GarmentLengths,
    pub(super) seed: u64,
    pub(super) shirt: Shirt,
    pub(super) trousers: Trousers,
    pub(super) crumple: Vec<Wave>,
    /// Phase (radians) and relative speed of the sway.
    pub(super) sway: [f64; 2],
    /// Smooth error of registrations of the subject.
    registration_error: Vec<Wave>,
}

/// The upper garment. Pairs are left and right.
#[derive(Debug, Clone)]
pub(super) struct Shirt {
    /// Ease (distance from the skin) of the body of the shirt at the hem.
    pub(super) ease: f64,
    /// Share by which the cloth hangs straight instead of following the body, 0 to 1.
    pub(super) drape: f64,
    /// Ease of the sleeves.
    pub(super) sleeve_ease: f64,
    /// Positions of the sleeve ends along the arms.
    pub(super) sleeve_end: [f64; 2],
    /// Downward shift of the collar.
    pub(super) collar: f64,
    /// Height of the hem above the hips.
    pub(super) hem: f64,
    /// Slope of the hem to the left and to the front.
    pub(super) hem_slope: [f64; 2],
    /// Amplitude and phase (radians) of the wave of the hem.
    pub(super) hem_wave: [f64; 2],
    /// True if the shirt is tucked into the trousers.
    pub(super) tucked: bool,
    /// Tangential shift around the body at the hem.
    pub(super) twist: f64,
    /// Tangential shift of each sleeve around the arm.
    pub(super) sleeve_twist: [f64; 2],
    /// Shift of each sleeve along the arm.
    pub(super) sleeve_slide: [f64; 2],
    /// Upward shift of the body of the shirt.
    pub(super) ride: f64,
    /// Shift of the hem to the left and to the front.
    pub(super) lean: [f64; 2],
    /// Vertical folds around the hem: number, phase (radians), slant.
    pub(super) folds: [f64; 3],
    /// Second, coarser set of vertical folds: number, phase (radians), slant.
    pub(super) gathers: [f64; 3],
    /// Phases of the sleeve folds, radians.
    pub(super) sleeve_phase: [f64; 2],
}

/// The lower garment. Pairs are left and right.
#[derive(Debug, Clone)]
pub(super) struct Trousers {
    /// Ease of the legs.
    pub(super) ease: f64,
    /// Share by which the legs hang straight instead of following the body, 0 to 1.
    pub(super) drape: f64,
    /// Relative growth of the ease towards the cuff.
    pub(super) flare: f64,
    /// Positions of the cuffs along the legs.
    pub(super) leg_end: [f64; 2],
    /// Upward shift of the waistband.
    pub(super) waist: f64,
    /// Extra ease of the seat.
    pub(super) seat: f64,
    /// Tangential shift of each trouser leg at the cuff.
    pub(super) twist: [f64; 2],
    /// Shift of each trouser leg along the leg.
    pub(super) slide: [f64; 2],
    /// Amplitude and phases (radians) of the folds that stack above the cuffs.
    pub(super) stack: f64,
    pub(super) stack_phase: [f64; 2],
    /// Phases of the lengthwise folds, radians.
    pub(super) fold_phase: [f64; 2],
}

/// Plane wave of a random displacement pattern.
#[derive(Debug, Clone, Copy)]
pub(super) struct Wave {
    /// Wave vector, radians per metre.
    pub(super) vector: DVec3,
    pub(super) phase: f64,
    pub(super) amplitude: f64,
    /// Tangential shift of the cloth that accompanies the wave, metres.
    pub(super) drag: DVec3,
    /// Phase per radian of waist bend.
    pub(super) follow: f64,
}

impl OutfitStyle {
    pub(super) fn random(outfit: Outfit, lengths: GarmentLengths, seed: u64) -> Self {
        let rng = &mut ChaCha8Rng::seed_from_u64(seed);
        let shirt = Shirt::random(lengths.long_sleeves, rng);
        let trousers = Trousers::random(lengths.long_legs, rng);
        let crumple = (0..WAVES).map(|_| Wave::random(rng)).collect();
        let sway = [rng.random_range(0.0..TAU), rng.random_range(0.5..1.1)];
        let registration_error =
            (0..REGISTRATION_WAVES).map(|_| Wave::random_registration_error(rng)).collect();
        Self { outfit, lengths, seed, shirt, trousers, crumple, sway, registration_error }
    }

    /// Combines the cut of this outfit with the fit of `other`: slip, twist and lean come from `other`,
    /// and the phases of the folds shift a little.
    pub(super) fn with_fit_of(self, other: Self) -> Self {
        let waves = self.crumple.into_iter().zip(&other.crumple);
        Self {
            outfit: self.outfit,
            lengths: self.lengths,
            seed: other.seed,
            shirt: self.shirt.with_fit_of(&other.shirt),
            trousers: self.trousers.with_fit_of(&other.trousers),
            crumple: waves
                .map(|(wave, other)| Wave {
                    phase: shift_phase(wave.phase, other.phase, 2.0 * PHASE_SHIFT),
                    amplitude: 0.8 * wave.amplitude + 0.6 * other.amplitude,
                    ..wave
                })
                .collect(),
            sway: other.sway,
            registration_error: self.registration_error,
        }
    }

    /// Smooth error of a registration at a rest position, metres.
    pub(super) fn registration_error(&self, position: DVec3) -> DVec3 {
        let waves = self.registration_error.iter();
        waves.map(|wave| wave.drag * (wave.vector.dot(position) + wave.phase).sin()).sum()
    }
}

/// Largest phase shift of folds between sequences, as a share of π.
const PHASE_SHIFT: f64 = 0.12;

/// Shifts `phase` by `share · (other − π)`, `other` in [0, 2π).
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
        let shifted = |[count, phase, slant]: [f64; 3], other: [f64; 3]| {
            [count, shift_phase(phase, other[1], PHASE_SHIFT), slant + 0.3 * other[2]]
        };
        Self {
            hem_slope: [0, 1].map(|i| 0.7 * self.hem_slope[i] + 0.7 * other.hem_slope[i]),
            hem_wave: [
                self.hem_wave[0],
                shift_phase(self.hem_wave[1], other.hem_wave[1], PHASE_SHIFT),
            ],
            twist: other.twist,
            sleeve_twist: other.sleeve_twist,
            sleeve_slide: other.sleeve_slide,
            ride: other.ride,
            lean: other.lean,
            folds: shifted(self.folds, other.folds),
            gathers: shifted(self.gathers, other.gathers),
            sleeve_phase: [0, 1]
                .map(|i| shift_phase(self.sleeve_phase[i], other.sleeve_phase[i], PHASE_SHIFT)),
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
        let shifted = |own: [f64; 2], other: [f64; 2]| {
            [0, 1].map(|i| shift_phase(own[i], other[i], PHASE_SHIFT))
        };
        Self {
            waist: 0.7 * self.waist + 0.7 * other.waist,
            twist: other.twist,
            slide: other.slide,
            stack_phase: shifted(self.stack_phase, other.stack_phase),
            fold_phase: shifted(self.fold_phase, other.fold_phase),
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
    fn random_registration_error(rng: &mut ChaCha8Rng) -> Self {
        let length = rng.random_range(0.15..0.6);
        let random = |rng: &mut ChaCha8Rng| DVec3::from_array(std::array::from_fn(|_| normal(rng)));
        Self {
            vector: random(rng).normalize_or(DVec3::Y) * (TAU / length),
            phase: angle(rng),
            amplitude: 0.0,
            drag: REGISTRATION_AMPLITUDE * random(rng),
            follow: 0.0,
        }
    }
}

/// Standard normal sample, clamped to ±2.2.
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
