//! Keeps the direction of the imports, the integers of the core and the top level of the repository.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// Which module may name which others. Imports point one way: wire -> service -> {log, engine} -> geometry.
const MAY_NAME: [(&str, &[&str]); 8] = [
    ("geometry", &[]),
    ("engine", &["geometry"]),
    ("log", &["geometry"]),
    ("service", &["engine", "geometry", "log"]),
    ("boundary", &["engine", "geometry"]),
    ("wire", &["boundary", "engine", "geometry", "service"]),
    ("toolpath", &[]),
    ("config", &["service", "wire"]),
];

/// Modules in which a float would be a mistake.
const INTEGERS_ONLY: [&str; 4] = ["geometry", "engine", "log", "service"];

/// The rooms of these modules that hold floats: they certify signs and roundings of exact integers, with the proof beside them.
const ROOMS_OF_FLOATS: [&str; 5] = [
    "src/engine/solids/certify.rs",
    "src/engine/solids/double.rs",
    "src/engine/solids/lanes.rs",
    "src/engine/solids/ledger.rs",
    "src/engine/solids/vector.rs",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// The sources of a module: `src/name.rs` and everything under `src/name`.
fn sources(module: &str) -> Vec<PathBuf> {
    let mut found = sources_under(root().join("src").join(module));
    let single = root().join("src").join(format!("{module}.rs"));
    found.extend(single.exists().then_some(single));
    found
}

fn sources_under(directory: PathBuf) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![directory];
    while let Some(directory) = open.pop() {
        for entry in fs::read_dir(directory).into_iter().flatten() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}

/// The code of a file line by line, without comments.
fn code(path: &Path) -> Vec<(usize, String)> {
    let text = fs::read_to_string(path).unwrap();
    let code = |line: &str| line.split("//").next().unwrap_or_default().to_owned();
    text.lines()
        .enumerate()
        .map(|(index, line)| (index + 1, code(line)))
        .collect()
}

/// Modules named after `crate::` in a line, braces included.
fn named(line: &str) -> Vec<String> {
    let mut names = Vec::new();
    for (at, _) in line.match_indices("crate::") {
        let rest = &line[at + "crate::".len()..];
        let list = rest
            .strip_prefix('{')
            .map_or(rest, |inside| inside.split('}').next().unwrap_or_default());
        let several = if rest.starts_with('{') {
            list.split(',').collect()
        } else {
            vec![list]
        };
        for name in several {
            let end = name
                .trim_start()
                .find(|letter: char| !letter.is_alphanumeric() && letter != '_');
            let name = name.trim_start();
            names.push(name[..end.unwrap_or(name.len())].to_owned());
        }
    }
    names
}

#[test]
fn imports_point_one_way() {
    let modules: BTreeSet<&str> = MAY_NAME
        .iter()
        .map(|(module, _)| *module)
        .chain(["cli"])
        .collect();
    for (module, allowed) in MAY_NAME {
        let sources = sources(module);
        assert!(!sources.is_empty(), "there is no module {module}");
        for path in sources {
            for (number, line) in code(&path) {
                for name in named(&line) {
                    let fine = name == module
                        || allowed.contains(&name.as_str())
                        || !modules.contains(name.as_str());
                    assert!(
                        fine,
                        "{}:{number}: {module} must not name {name}: {line}",
                        path.display()
                    );
                }
            }
        }
    }
}

/// The paths that a source names: those of `use`, one by one, and others that begin with `crate` or `super`. Without the module
/// of tests at its end.
fn paths(path: &Path) -> Vec<Vec<String>> {
    let lines = code(path).into_iter().map(|(_, line)| line);
    let text: String = lines.collect::<Vec<_>>().join(" ");
    let text = match text.find("#[cfg(test)] mod tests {") {
        Some(end) => &text[..end],
        None => &text,
    };
    let mut found = Vec::new();
    for (at, _) in text.match_indices("use ") {
        let statement = text[at + "use ".len()..].split(';').next();
        found.extend(imported(statement.unwrap_or_default()));
    }
    for root in ["crate::", "super::"] {
        for (at, _) in text.match_indices(root) {
            let ends = |letter: char| !(letter.is_alphanumeric() || letter == '_' || letter == ':');
            found.extend(text[at..].split(ends).next().map(str::to_owned));
        }
    }
    let parts = |path: &String| {
        path.split("::")
            .map(|part| part.trim().to_owned())
            .collect()
    };
    found.iter().map(parts).collect()
}

/// Every path of a tree such as `a::{b, c::{d, e}}`.
fn imported(tree: &str) -> Vec<String> {
    let Some((before, inside)) = tree.split_once('{') else {
        return vec![
            tree.split(" as ")
                .next()
                .unwrap_or_default()
                .trim()
                .to_owned(),
        ];
    };
    let inside = inside.rsplit_once('}').map_or(inside, |(inside, _)| inside);
    let mut depth = 0;
    let branches = inside.split(|letter: char| {
        depth += i32::from(letter == '{') - i32::from(letter == '}');
        depth == 0 && letter == ','
    });
    let branches = branches.flat_map(imported);
    branches
        .map(|branch| format!("{}{branch}", before.trim()))
        .collect()
}

/// Where a path leads, as modules from the root of `src`, when `from` names it; none when it leads out of the crate.
fn absolute(path: &[String], from: &[String]) -> Option<Vec<String>> {
    let ups = path.iter().take_while(|part| *part == "super").count();
    match path.first()?.as_str() {
        "crate" => Some(path[1..].to_vec()),
        "super" => Some([&from[..from.len().checked_sub(ups)?], &path[ups..]].concat()),
        _ => None,
    }
}

#[test]
fn no_two_siblings_import_each_other() {
    let src = root().join("src");
    let mut imports: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for source in sources_under(src.clone()) {
        let relative = source.strip_prefix(&src).unwrap().with_extension("");
        let module = relative
            .iter()
            .map(|part| part.to_str().unwrap().to_owned());
        let module: Vec<String> = module
            .filter(|part| !["mod", "lib", "main"].contains(&part.as_str()))
            .collect();
        for path in paths(&source) {
            let Some(to) = absolute(&path, &module) else {
                continue;
            };
            // Below the last module that both are in lie the two siblings.
            let common = module
                .iter()
                .zip(&to)
                .take_while(|(one, other)| one == other);
            let common = common.count();
            if common == module.len().min(to.len()) {
                continue;
            }
            let name = |of: &[String]| format!("src/{}", of[..=common].join("/"));
            let (one, other) = (name(&module), name(&to));
            let is_module =
                root().join(&other).is_dir() || root().join(format!("{other}.rs")).exists();
            if is_module {
                imports.entry(one).or_default().insert(other);
            }
        }
    }
    assert!(imports.len() > 50, "imports are found: {}", imports.len());
    let names =
        |one: &String, other: &String| imports.get(one).is_some_and(|all| all.contains(other));
    for (one, others) in &imports {
        for other in others {
            assert!(
                !names(other, one),
                "{one} and {other} import each other: move what both need below them, or join them"
            );
        }
    }
}

#[test]
fn the_core_has_no_floats_and_no_async() {
    for module in INTEGERS_ONLY {
        for path in sources(module) {
            let holds_floats = ROOMS_OF_FLOATS.iter().any(|room| path == root().join(room));
            for (number, line) in code(&path) {
                let words: Vec<&str> = line
                    .split(|letter: char| !letter.is_alphanumeric() && letter != '_')
                    .collect();
                for float in ["f32", "f64"] {
                    assert!(
                        holds_floats || !words.contains(&float),
                        "{}:{number}: a float in {module}: {line}",
                        path.display()
                    );
                }
                if module != "service" {
                    for word in ["async", "await", "tokio", "serde"] {
                        assert!(
                            !words.contains(&word),
                            "{}:{number}: {word} in {module}: {line}",
                            path.display()
                        );
                    }
                }
            }
        }
    }
}

/// What is quoted must not depend on how the server keeps its data.
#[test]
fn the_benchmarks_know_the_server_as_its_users_do() {
    let sources = sources_under(root().join("tests/bench/src"));
    assert!(!sources.is_empty(), "there are benchmarks");
    for path in sources {
        for (number, line) in code(&path) {
            for private in ["union3d::log", "union3d::service", "sqlite"] {
                assert!(
                    !line.contains(private),
                    "{}:{number}: {private} in a benchmark: {line}",
                    path.display()
                );
            }
        }
    }
}

#[test]
fn the_top_level_holds_nothing_else() {
    let expected = [
        "Cargo.lock",
        "Cargo.toml",
        "Dockerfile",
        "README.md",
        "deploy",
        "proto",
        "src",
        "tests",
    ];
    let entries = fs::read_dir(root())
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let found: BTreeSet<String> = entries
        .filter(|name| !name.starts_with('.') && name != "target" && name != "union3d-data")
        .collect();
    assert_eq!(found, expected.map(str::to_owned).into());
}
