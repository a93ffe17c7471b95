//! The fields of a line.

/// What stands between two fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Separator {
    /// A comma, spaces around it allowed.
    Comma,
    /// A semicolon, spaces around it allowed.
    Semicolon,
    /// Spaces or tabs, any number.
    Space,
}

impl Separator {
    /// What separates the fields of a line.
    pub(crate) fn of(line: &[u8]) -> Separator {
        if line.contains(&b';') {
            Separator::Semicolon
        } else if line.contains(&b',') {
            Separator::Comma
        } else {
            Separator::Space
        }
    }

    /// The fields of a line, without spaces around them.
    pub(crate) fn fields(self, line: &[u8]) -> Fields<'_> {
        Fields { separator: self, rest: Some(line.trim_ascii()) }
    }
}

/// Walks over the fields of a line.
pub(crate) struct Fields<'a> {
    separator: Separator,
    rest: Option<&'a [u8]>,
}

impl<'a> Iterator for Fields<'a> {
    type Item = &'a [u8];

    #[inline]
    fn next(&mut self) -> Option<&'a [u8]> {
        let rest = self.rest?;
        let ends = match self.separator {
            Separator::Comma => rest.iter().position(|&byte| byte == b','),
            Separator::Semicolon => rest.iter().position(|&byte| byte == b';'),
            Separator::Space => {
                if rest.is_empty() {
                    self.rest = None;
                    return None;
                }
                rest.iter().position(|&byte| byte == b' ' || byte == b'\t')
            }
        };
        match ends {
            Some(end) => {
                self.rest = Some(if self.separator == Separator::Space {
                    rest[end..].trim_ascii_start()
                } else {
                    &rest[end + 1..]
                });
                Some(rest[..end].trim_ascii())
            }
            None => {
                self.rest = None;
                Some(rest.trim_ascii())
            }
        }
    }
}

/// Is this line empty or a comment?
#[inline]
pub(crate) fn is_comment(line: &[u8]) -> bool {
    matches!(line.trim_ascii_start().first(), None | Some(b'#' | b'%'))
}
