//! What the commands that read files share.

use std::fs::File;
use std::io::{BufRead, Read};
use std::path::Path;

use union3d::wire::convert::InvalidSetting;

/// Something to read, and its size if that is known.
pub(crate) type Input = (Box<dyn Read + Send>, Option<u64>);

/// A file (- is standard input) and its size, if that is known.
pub(crate) fn open(path: &Path) -> Result<Input, Box<dyn std::error::Error>> {
    if path == Path::new("-") {
        return Ok((Box::new(std::io::stdin()), None));
    }
    let file = File::open(path).map_err(about(path))?;
    let metadata = file.metadata().map_err(about(path))?;
    if metadata.is_dir() {
        return Err(format!("{} is a directory", path.display()).into());
    }
    Ok((Box::new(file), metadata.is_file().then_some(metadata.len())))
}

/// Reads a file of text line by line, without the blank ones: the number of each, from 1, and its text.
pub(crate) fn each_line(
    mut source: impl BufRead,
    line_bytes_max: u64,
    mut visit: impl FnMut(u64, &[u8]) -> Result<(), Box<dyn std::error::Error>>,
) -> Result<(), Box<dyn std::error::Error>> {
    let mut text = Vec::new();
    for line in 1.. {
        text.clear();
        let size = source
            .by_ref()
            .take(line_bytes_max + 1)
            .read_until(b'\n', &mut text)?;
        if size == 0 {
            break;
        }
        let text = text.trim_ascii();
        if size as u64 > line_bytes_max {
            return Err(format!("line {line}: it is longer than {line_bytes_max} bytes").into());
        }
        if !text.is_empty() {
            visit(line, text)?;
        }
    }
    Ok(())
}

/// The beginning of a line, to be shown beside what is wrong with it.
pub(crate) fn excerpt(text: &[u8]) -> String {
    const CHARACTERS_MAX: usize = 80;
    let text = String::from_utf8_lossy(text);
    match text.char_indices().nth(CHARACTERS_MAX) {
        Some((end, _)) => format!("{} ...", &text[..end]),
        None => text.into_owned(),
    }
}

/// Names the file in an error.
pub(crate) fn about(path: &Path) -> impl Fn(std::io::Error) -> String {
    move |error| format!("{}: {error}", path.display())
}

/// Settings at fault, as options of the command line.
pub(crate) fn faults(faults: &[InvalidSetting]) -> String {
    let texts = faults
        .iter()
        .map(|fault| format!("--{}: {fault}", fault.field().replace('_', "-")));
    texts.collect::<Vec<_>>().join("; ")
}
