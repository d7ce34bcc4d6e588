//! Directories that appear whole or not at all.

use std::{
    fs,
    path::{Path, PathBuf},
};

use crate::{Error, Result};

/// The directory being filled, hidden beside its final place and removed unless committed. What a
/// killed run left behind is removed by the next one.
pub(crate) struct Staging {
    pub(crate) path: PathBuf,
}

impl Staging {
    pub(crate) fn create(out: &Path) -> Result<Self> {
        let fail = |e| Error::io(out, e);
        if out.exists() && (!out.is_dir() || fs::read_dir(out).map_err(fail)?.next().is_some()) {
            return Err(Error::Data(format!(
                "{} exists already: remove it, or choose another place",
                out.display()
            )));
        }
        let Some(name) = out.file_name() else {
            return Err(Error::argument(format!("{} is not a directory's name", out.display())));
        };
        let path = out.with_file_name(format!(".{}.cape-partial", name.to_string_lossy()));
        if path.exists() {
            fs::remove_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        }
        fs::create_dir_all(&path).map_err(|e| Error::io(&path, e))?;
        Ok(Self { path })
    }

    pub(crate) fn commit(self, out: &Path) -> Result<()> {
        if out.is_dir() {
            fs::remove_dir(out).map_err(|e| Error::io(out, e))?;
        }
        fs::rename(&self.path, out).map_err(|e| Error::io(out, e))
    }
}

impl Drop for Staging {
    fn drop(&mut self) {
        // After a commit there is nothing left here, and a failure to clean up has no better place
        // to go.
        let _ = fs::remove_dir_all(&self.path);
    }
}
