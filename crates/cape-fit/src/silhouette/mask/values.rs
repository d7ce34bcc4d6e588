//! Masks among the values of an image: of two values, soft masks, and label images.

use std::{collections::BTreeMap, fmt, str::FromStr};

use super::Mask;
use crate::{Error, Result};

/// Share of the largest value below which a pixel of a soft mask is background, and of one minus
/// which above it is the person.
const CLEAR: f64 = 0.15;
/// Largest number of unclear pixels of a soft mask, as a share of the clear ones of the person.
const UNCLEAR: f64 = 0.25;
/// Largest number of values of a label image without a palette.
const FEW: usize = 40;
/// Labels that an error lists.
const LISTED: usize = 12;

/// Label of a label image: a value (or index of a palette), or a colour `#rrggbb`.
///
/// ```
/// use cape_fit::silhouette::MaskLabel;
///
/// assert_eq!("15".parse(), Ok(MaskLabel::Value(15)));
/// assert_eq!("#c08080".parse(), Ok(MaskLabel::Colour([192, 128, 128])));
/// assert!("person".parse::<MaskLabel>().is_err());
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MaskLabel {
    /// Value of a pixel, or index of its colour in a palette.
    Value(u32),
    /// RGB colour of a pixel.
    Colour([u8; 3]),
}

impl FromStr for MaskLabel {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("`{text}`: expected a number or a colour #rrggbb");
        match text.trim().strip_prefix('#') {
            Some(hex) if hex.len() == 6 && hex.is_ascii() => {
                let number = u32::from_str_radix(hex, 16).map_err(|_| expected())?;
                let [_, r, g, b] = number.to_be_bytes();
                Ok(Self::Colour([r, g, b]))
            }
            Some(_) => Err(expected()),
            None => text.trim().parse().map(Self::Value).map_err(|_| expected()),
        }
    }
}

impl fmt::Display for MaskLabel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Value(value) => value.fmt(f),
            Self::Colour([r, g, b]) => write!(f, "#{r:02x}{g:02x}{b:02x}"),
        }
    }
}

/// Value of each pixel of an image.
#[derive(Debug, Clone)]
pub(super) struct ValueImage {
    pub(super) width: u32,
    pub(super) height: u32,
    /// Values, row by row, `[height · width]`.
    pub(super) values: Vec<u32>,
    /// Largest value that the file can have.
    pub(super) largest: u32,
    /// Colours of the values; `None` if the values are brightnesses or labels.
    pub(super) colours: Option<BTreeMap<u32, [u8; 3]>>,
    /// True for values that are colours themselves, without a palette.
    pub(super) coloured: bool,
    /// True if compression has changed the values.
    pub(super) noisy: bool,
}

impl ValueImage {
    /// The mask of the labels, or, without labels, of the image as a mask; an error says what the
    /// image is instead.
    pub(super) fn mask(&self, labels: &[MaskLabel]) -> Result<Mask, String> {
        let mut counts = BTreeMap::new();
        for &value in &self.values {
            *counts.entry(value).or_insert(0usize) += 1;
        }
        if !labels.is_empty() {
            return self.labelled(labels, &counts);
        }
        let on: Box<dyn Fn(u32) -> bool> = match *counts.keys().collect::<Vec<_>>() {
            [] => return Err("the image is empty".into()),
            [&only] => Box::new(move |_| self.brightness(only) > 0),
            [&a, &b] => {
                let person = if self.brightness(a) > self.brightness(b) { a } else { b };
                Box::new(move |value| value == person)
            }
            _ if self.is_soft(&counts) => {
                let most = counts.keys().next_back().copied().unwrap_or(0);
                Box::new(move |value| 2 * u64::from(value) > u64::from(most))
            }
            _ => return Err(self.description(&counts)),
        };
        self.covered(on)
    }

    fn covered(&self, on: impl Fn(u32) -> bool) -> Result<Mask, String> {
        let covered = self.values.iter().map(|&value| on(value)).collect();
        Mask::new(self.width, self.height, covered).map_err(|error| error.to_string())
    }

    fn labelled(
        &self,
        labels: &[MaskLabel],
        counts: &BTreeMap<u32, usize>,
    ) -> Result<Mask, String> {
        let is = |value: u32| {
            labels.iter().any(|label| match *label {
                MaskLabel::Value(wanted) => !self.coloured && wanted == value,
                MaskLabel::Colour(wanted) => self.colour(value) == Some(wanted),
            })
        };
        if counts.keys().any(|&value| is(value)) {
            return self.covered(is);
        }
        let labels: Vec<String> = labels.iter().map(ToString::to_string).collect();
        Err(format!("no pixel has the label {}: it has {}", labels.join(" or "), self.list(counts)))
    }

    /// Brightness of a value, for comparison with that of others.
    fn brightness(&self, value: u32) -> u32 {
        match self.colour(value) {
            Some([r, g, b]) => u32::from(r.max(g).max(b)),
            None => value,
        }
    }

    fn colour(&self, value: u32) -> Option<[u8; 3]> {
        self.colours.as_ref().and_then(|colours| colours.get(&value)).copied()
    }

    /// True if nearly all pixels are close to 0 or to the largest value, which is large.
    fn is_soft(&self, counts: &BTreeMap<u32, usize>) -> bool {
        let most = counts.keys().next_back().copied().unwrap_or(0);
        if self.colours.is_some() || 2 * u64::from(most) < u64::from(self.largest) {
            return false;
        }
        let clear = if self.noisy || counts.len() > FEW { CLEAR } else { 0.0 };
        let share = |value: u32| f64::from(value) / f64::from(most);
        let sum = |of: &dyn Fn(f64) -> bool| -> usize {
            counts.iter().filter(|(value, _)| of(share(**value))).map(|(_, count)| count).sum()
        };
        let person = sum(&|share| share >= 1.0 - clear);
        let unclear = sum(&|share| share > clear && share < 1.0 - clear);
        unclear as f64 <= UNCLEAR * person as f64
    }

    /// Description of an image that is no mask by itself.
    fn description(&self, counts: &BTreeMap<u32, usize>) -> String {
        let palette = self.colours.is_some() && !self.coloured;
        if !self.noisy && (palette || counts.len() <= FEW) {
            return format!(
                "a label image with {} labels, {}: choose those of the person by --labels",
                counts.len(),
                self.list(counts)
            );
        }
        "a photograph, expected a mask: the person white on black, a cut-out, or a label image; \
         photographs are given by --image"
            .into()
    }

    /// Labels with their share of the pixels, the most frequent first.
    fn list(&self, counts: &BTreeMap<u32, usize>) -> String {
        let mut list: Vec<(u32, usize)> = counts.iter().map(|(&v, &n)| (v, n)).collect();
        list.sort_by_key(|&(value, count)| (std::cmp::Reverse(count), value));
        let label = |value: u32| match self.colour(value) {
            Some(colour) if self.coloured => MaskLabel::Colour(colour).to_string(),
            Some(colour) => format!("{value} {}", MaskLabel::Colour(colour)),
            None => value.to_string(),
        };
        let share = |count: usize| 100.0 * count as f64 / self.values.len() as f64;
        let mut text: Vec<String> = list
            .iter()
            .take(LISTED)
            .map(|&(value, count)| format!("{} ({:.1} %)", label(value), share(count)))
            .collect();
        if list.len() > LISTED {
            text.push("…".into());
        }
        text.join(", ")
    }
}

impl From<MaskLabel> for u32 {
    fn from(label: MaskLabel) -> Self {
        match label {
            MaskLabel::Value(value) => value,
            MaskLabel::Colour([r, g, b]) => Self::from_be_bytes([0, r, g, b]),
        }
    }
}

/// [`Error::Observation`] of a message.
pub(super) fn refuse<T>(message: String) -> Result<T> {
    Err(Error::Observation(message))
}
