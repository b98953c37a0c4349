//! What the commands that read files share.

use std::fs::File;
use std::io::Read;
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
