use std::{cmp::Ordering, fmt, hash::Hash, ops::Deref, str::FromStr};

use serde::{Deserialize, Serialize};

use crate::{Error, Result};

/// Words that stand for several outfits in commands and files.
const RESERVED: [&str; 2] = ["all", "auto"];

/// Name of an outfit: the clothing type `c` of CAPE (§3), upper garment first, such as `shortlong` or
/// `jerseyshort`.
///
/// A name has 1 to 31 letters, digits, `-`, `.` and `+`; captures are called `<outfit>_<sequence>`.
/// The paper's four come before all others in the order of outfits, the others by name.
///
/// ```
/// use cape_core::Outfit;
///
/// let outfit: Outfit = "jerseyshort".parse()?;
/// assert_eq!((outfit.name(), outfit.to_string().as_str()), ("jerseyshort", "jerseyshort"));
/// assert_eq!("longlong".parse::<Outfit>()?, Outfit::LONG_LONG);
/// assert!(Outfit::LONG_LONG < outfit);
/// assert!("polo_short".parse::<Outfit>().is_err());
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct Outfit {
    bytes: [u8; Self::MOST_BYTES],
    length: u8,
}

impl Outfit {
    /// Longest name, bytes.
    pub const MOST_BYTES: usize = 31;

    /// Short sleeves, long trousers.
    pub const SHORT_LONG: Self = Self::literal("shortlong");
    /// Short sleeves, short trousers.
    pub const SHORT_SHORT: Self = Self::literal("shortshort");
    /// Long sleeves, short trousers.
    pub const LONG_SHORT: Self = Self::literal("longshort");
    /// Long sleeves, long trousers.
    pub const LONG_LONG: Self = Self::literal("longlong");

    /// The paper's four outfits, in the order of the release's one-hot labels.
    pub const PAPER: [Self; 4] =
        [Self::SHORT_LONG, Self::SHORT_SHORT, Self::LONG_SHORT, Self::LONG_LONG];

    /// The outfit of a name that is known to be valid.
    const fn literal(name: &str) -> Self {
        let mut bytes = [0; Self::MOST_BYTES];
        let (head, _) = bytes.split_at_mut(name.len());
        head.copy_from_slice(name.as_bytes());
        Self { bytes, length: name.len() as u8 }
    }

    /// Name of the outfit in directory and file names.
    pub fn name(&self) -> &str {
        // All bytes are ASCII.
        str::from_utf8(&self.bytes[..usize::from(self.length)]).unwrap_or_default()
    }

    /// Stream of random numbers of the outfit: 0 to 3 for the paper's four, a hash of the name
    /// (FNV-1a, 16 bits) above them for others. It does not depend on a vocabulary.
    pub fn stream(&self) -> u64 {
        if let Some(index) = Self::PAPER.iter().position(|outfit| outfit == self) {
            return index as u64;
        }
        let hash = self.name().bytes().fold(0xcbf2_9ce4_8422_2325, |hash: u64, byte| {
            (hash ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3)
        });
        4 + ((hash ^ (hash >> 32)) & 0x7fff)
    }
}

impl Ord for Outfit {
    fn cmp(&self, other: &Self) -> Ordering {
        let place = |outfit: &Self| {
            Self::PAPER.iter().position(|known| known == outfit).unwrap_or(Self::PAPER.len())
        };
        place(self).cmp(&place(other)).then_with(|| self.name().cmp(other.name()))
    }
}

impl PartialOrd for Outfit {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl fmt::Debug for Outfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Outfit({})", self.name())
    }
}

impl fmt::Display for Outfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for Outfit {
    type Err = Error;

    fn from_str(name: &str) -> Result<Self> {
        let plain = |c: char| c.is_ascii_alphanumeric() || matches!(c, '-' | '.' | '+');
        let fits = (1..=Self::MOST_BYTES).contains(&name.len());
        if !fits || name.starts_with('.') || !name.chars().all(plain) {
            return Err(Error::Argument(format!(
                "outfit `{name}`: expected a name of 1 to {} letters, digits, `-`, `.` and `+`, such \
                 as `shortlong`",
                Self::MOST_BYTES
            )));
        }
        if RESERVED.contains(&name) {
            return Err(Error::Argument(format!(
                "outfit `{name}`: `all` and `auto` stand for several outfits: choose another name"
            )));
        }
        Ok(Self::literal(name))
    }
}

impl TryFrom<String> for Outfit {
    type Error = Error;

    fn try_from(name: String) -> Result<Self> {
        name.parse()
    }
}

impl From<Outfit> for String {
    fn from(outfit: Outfit) -> Self {
        outfit.name().to_owned()
    }
}

/// Ordered list of distinct outfits, at least one: the classes of one-hot outfit labels `[n, outfits]`.
/// It is a slice of [`Outfit`]s; the default has the paper's four.
///
/// ```
/// use cape_core::{Outfit, OutfitVocabulary};
///
/// let outfits = OutfitVocabulary::default();
/// assert_eq!(outfits.one_hot(Outfit::SHORT_SHORT)?, [0.0, 1.0, 0.0, 0.0]);
///
/// let outfits = OutfitVocabulary::new(["jerseyshort".parse()?, Outfit::LONG_LONG])?;
/// assert_eq!((outfits.len(), outfits.index(Outfit::LONG_LONG)), (2, Some(1)));
/// let message = outfits.choose("shortlong").unwrap_err().to_string();
/// assert!(message.contains("expected one of jerseyshort, longlong"));
/// # Ok::<(), cape_core::Error>(())
/// ```
#[derive(Debug, Clone, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(try_from = "Vec<Outfit>", into = "Vec<Outfit>")]
pub struct OutfitVocabulary(Vec<Outfit>);

impl OutfitVocabulary {
    /// A list of outfits in the order of one-hot labels.
    ///
    /// # Errors
    /// If it is empty, or an outfit is listed twice.
    pub fn new(outfits: impl IntoIterator<Item = Outfit>) -> Result<Self> {
        let outfits: Vec<Outfit> = outfits.into_iter().collect();
        if outfits.is_empty() {
            return Err(Error::Argument("outfits: the list is empty: expected one or more".into()));
        }
        for (place, outfit) in outfits.iter().enumerate() {
            if outfits[..place].contains(outfit) {
                return Err(Error::Argument(format!("outfits: `{outfit}` is listed twice")));
            }
        }
        Ok(Self(outfits))
    }

    /// Names for `count` outfits that are known by their place only: the paper's four, or `outfit1`,
    /// `outfit2` and so on.
    ///
    /// # Errors
    /// If `count` is 0.
    pub fn numbered(count: usize) -> Result<Self> {
        if count == Outfit::PAPER.len() {
            return Ok(Self::default());
        }
        let names = (1..=count).map(|place| format!("outfit{place}").parse());
        Self::new(names.collect::<Result<Vec<_>>>()?)
    }

    /// True if it is the paper's list.
    pub fn is_paper(&self) -> bool {
        self.0 == Outfit::PAPER
    }

    /// Place of an outfit in one-hot labels.
    pub fn index(&self, outfit: Outfit) -> Option<usize> {
        self.iter().position(|&known| known == outfit)
    }

    /// Place of an outfit in one-hot labels.
    ///
    /// # Errors
    /// If the list does not have it; the message has the list.
    pub fn require(&self, outfit: Outfit) -> Result<usize> {
        self.index(outfit).ok_or_else(|| self.unknown(outfit.name()))
    }

    /// One-hot label of an outfit, the condition of the network, `[outfits]`.
    ///
    /// # Errors
    /// If the list does not have it; the message has the list.
    pub fn one_hot(&self, outfit: Outfit) -> Result<Vec<f32>> {
        let mut label = vec![0.0; self.len()];
        label[self.require(outfit)?] = 1.0;
        Ok(label)
    }

    /// Outfit of a name.
    ///
    /// # Errors
    /// If the list does not have it; the message has the list.
    pub fn choose(&self, name: &str) -> Result<Outfit> {
        self.iter().copied().find(|outfit| outfit.name() == name).ok_or_else(|| self.unknown(name))
    }

    fn unknown(&self, name: &str) -> Error {
        Error::Argument(format!("unknown outfit `{name}`: expected one of {self}"))
    }
}

impl Default for OutfitVocabulary {
    fn default() -> Self {
        Self(Outfit::PAPER.to_vec())
    }
}

impl Deref for OutfitVocabulary {
    type Target = [Outfit];

    fn deref(&self) -> &[Outfit] {
        &self.0
    }
}

impl<'a> IntoIterator for &'a OutfitVocabulary {
    type Item = &'a Outfit;
    type IntoIter = std::slice::Iter<'a, Outfit>;

    fn into_iter(self) -> Self::IntoIter {
        self.0.iter()
    }
}

impl fmt::Display for OutfitVocabulary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (place, outfit) in self.iter().enumerate() {
            write!(f, "{}{outfit}", if place > 0 { ", " } else { "" })?;
        }
        Ok(())
    }
}

impl TryFrom<Vec<Outfit>> for OutfitVocabulary {
    type Error = Error;

    fn try_from(outfits: Vec<Outfit>) -> Result<Self> {
        Self::new(outfits)
    }
}

impl From<OutfitVocabulary> for Vec<Outfit> {
    fn from(vocabulary: OutfitVocabulary) -> Self {
        vocabulary.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_checked() {
        for name in ["shortlong", "blazerlong", "a", "T-shirt+2.b", &"x".repeat(31)] {
            assert_eq!(name.parse::<Outfit>().unwrap().name(), name);
        }
        for name in ["", "a_b", "a/b", ".a", "é", "a b", "all", "auto", &"x".repeat(32)] {
            assert!(name.parse::<Outfit>().is_err(), "{name}");
        }
        assert_eq!(size_of::<Outfit>(), 32);
    }

    #[test]
    fn the_papers_outfits_come_first_in_label_order() {
        let mut outfits = ["blazerlong", "longlong", "shortshort", "a", "shortlong", "longshort"]
            .map(|name| name.parse::<Outfit>().unwrap());
        outfits.sort();
        let expected = ["shortlong", "shortshort", "longshort", "longlong", "a", "blazerlong"];
        assert_eq!(outfits.each_ref().map(Outfit::name), expected);
        assert_eq!(Outfit::PAPER.each_ref().map(Outfit::stream), [0, 1, 2, 3]);
        assert!(outfits[4].stream() >= 4 && outfits[4].stream() != outfits[5].stream());
    }

    #[test]
    fn json_holds_names() {
        let outfits = OutfitVocabulary::default();
        let text = serde_json::to_string(&outfits).unwrap();
        assert_eq!(text, r#"["shortlong","shortshort","longshort","longlong"]"#);
        assert_eq!(serde_json::from_str::<OutfitVocabulary>(&text).unwrap(), outfits);
        for wrong in ["[]", r#"["a","a"]"#, r#"["a_b"]"#] {
            assert!(serde_json::from_str::<OutfitVocabulary>(wrong).is_err(), "{wrong}");
        }
    }

    #[test]
    fn places_without_names_are_numbered() {
        assert!(OutfitVocabulary::numbered(4).unwrap().is_paper());
        let two = OutfitVocabulary::numbered(2).unwrap();
        assert_eq!(two.to_string(), "outfit1, outfit2");
        assert!(OutfitVocabulary::numbered(0).is_err());
    }
}
