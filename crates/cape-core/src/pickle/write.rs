//! Writer of the one kind of pickle that data sets need.

use std::{fmt::Write as _, io::Write as _, path::Path};

use crate::{Result, write_atomically};

/// Writes a dictionary of texts as a pickle of protocol 0, which all versions of Python read.
///
/// ```
/// use cape_core::pickle::{Pickle, write_texts};
///
/// let directory = tempfile::tempdir()?;
/// let path = directory.path().join("subj_genders.pkl");
/// write_texts(&path, [("s0001", "male"), ("s0002", "female")])?;
/// let pickle = Pickle::open(&path)?;
/// assert_eq!(pickle.root().keys(), ["s0001", "s0002"]);
/// assert_eq!(pickle.root().require("s0002")?.text()?, "female");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
///
/// # Errors
/// If the file cannot be written.
pub fn write_texts<'a>(
    path: impl AsRef<Path>,
    items: impl IntoIterator<Item = (&'a str, &'a str)>,
) -> Result<()> {
    // Mark, then keys and values, then the dictionary of what is above the mark.
    let mut program = "(".to_owned();
    for text in items.into_iter().flat_map(<[&str; 2]>::from) {
        program.push('V');
        for c in text.chars() {
            match c {
                '\\' | '\n' | '\r' | '\0' | '\x1a' | '\u{80}'.. => {
                    let code = u32::from(c);
                    // Writing to a string cannot fail.
                    let _ = if code > 0xffff {
                        write!(program, "\\U{code:08x}")
                    } else {
                        write!(program, "\\u{code:04x}")
                    };
                }
                _ => program.push(c),
            }
        }
        program.push('\n');
    }
    program.push_str("d.");
    write_atomically(path.as_ref(), |file| file.write_all(program.as_bytes()))
}
