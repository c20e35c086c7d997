//! Names of columns: with a unit in parentheses or without.

/// The plain text and the unit of a name such as `Pressure (bar)` or `time[ms]`.
pub(super) fn bracketed(name: &str) -> Option<(&str, &str)> {
    let inner = name.trim_end();
    for (open, close) in [('(', ')'), ('[', ']')] {
        if let Some(body) = inner.strip_suffix(close)
            && let Some((plain, unit)) = body.rsplit_once(open)
        {
            return Some((plain.trim_end(), unit.trim()));
        }
    }
    None
}

/// The position of the column called `wanted`: by its whole name, else by its name without the unit in parentheses.
pub(super) fn position(headers: &[String], wanted: &str) -> Option<usize> {
    headers.iter().position(|name| name == wanted).or_else(|| {
        let mut plain = headers.iter().enumerate().filter(|(_, name)| bracketed(name).is_some_and(|(plain, _)| plain == wanted));
        // Two columns of one plain name are not told apart by it.
        plain.next().filter(|_| plain.next().is_none()).map(|(index, _)| index)
    })
}
