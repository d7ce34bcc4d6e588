use std::fmt::Write;

/// Bytes in hexadecimal, two lower-case digits each.
///
/// ```
/// assert_eq!(cape_core::hex([0x0f, 0xa0]), "0fa0");
/// ```
pub fn hex(bytes: impl AsRef<[u8]>) -> String {
    bytes.as_ref().iter().fold(String::new(), |mut text, byte| {
        let _ = write!(text, "{byte:02x}");
        text
    })
}
