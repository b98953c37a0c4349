//! The settings of the server: which source wins, and what is refused.

use std::path::PathBuf;

use union3d::config::{LogFormat, ServeConfig, ServeFlags};

fn variables(list: &[(&str, &str)]) -> Vec<(String, String)> {
    let owned = |&(name, value): &(&str, &str)| (name.to_owned(), value.to_owned());
    list.iter().map(owned).collect()
}

/// Merges a file of this text with variables and flags.
fn merge(text: &str, list: &[(&str, &str)], flags: &ServeFlags) -> Result<ServeConfig, String> {
    let directory = tempfile::tempdir().unwrap();
    let file = directory.path().join("union3d.toml");
    std::fs::write(&file, text).unwrap();
    ServeConfig::merge(Some(&file), variables(list), flags).map_err(|error| error.to_string())
}

#[test]
fn nothing_set_gives_the_defaults() {
    let none = ServeConfig::merge(None, [], &ServeFlags::default()).unwrap();
    assert_eq!(none, ServeConfig::default());
    assert_eq!(
        merge("", &[], &ServeFlags::default()),
        Ok(ServeConfig::default())
    );
    assert_eq!(none.http.to_string(), "127.0.0.1:7373");
    assert_eq!(none.grpc.to_string(), "127.0.0.1:7374");
}

/// The example has every setting, and says the defaults: with the comment marks taken off those that have a value it sets nothing else.
#[test]
fn the_example_is_what_the_defaults_are() {
    let example = union3d::config::example();
    let kept = std::fs::read_to_string(
        PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("deploy/union3d.toml"),
    );
    assert_eq!(
        kept.unwrap(),
        example,
        "write it anew: union3d config > deploy/union3d.toml"
    );
    let settings: Vec<&str> = example
        .lines()
        .filter_map(|line| line.strip_prefix('#'))
        .filter(|line| !line.starts_with(' '))
        .collect();
    let defaults = serde_json::to_value(ServeConfig::default()).unwrap();
    let names: Vec<&str> = settings
        .iter()
        .map(|line| line.split(' ').next().unwrap())
        .collect();
    let mut sorted = names.clone();
    sorted.sort_unstable();
    assert!(
        sorted.iter().eq(defaults.as_object().unwrap().keys()),
        "{sorted:?}"
    );
    // What has no default of its own stands there with what kind of thing it is.
    let is_word = |line: &&&str| line.ends_with(|letter: char| letter.is_ascii_uppercase());
    let words: Vec<&str> = settings.iter().filter(is_word).copied().collect();
    assert_eq!(
        words,
        [
            "tls_certificate = FILE",
            "tls_key = FILE",
            "tls_client_ca = FILE",
            "keys = FILE",
            "memory_bytes_max = BYTES"
        ]
    );
    let values: Vec<&str> = settings
        .iter()
        .filter(|line| !is_word(line))
        .copied()
        .collect();
    assert_eq!(
        merge(&values.join("\n"), &[], &ServeFlags::default()),
        Ok(ServeConfig::default())
    );
}

#[test]
fn flags_win_over_variables_over_the_file() {
    let text =
        "http = '127.0.0.1:1'\nqueue_changes_max = 1\nbody_bytes_max = 1\nlog_format = 'json'\n";
    let list = [
        ("UNION3D_HTTP", "[::1]:2"),
        ("UNION3D_QUEUE_CHANGES_MAX", "2"),
        ("UNION3D_LOG_FILTER", "debug"),
    ];
    let flags = ServeFlags {
        http: Some("127.0.0.1:0".parse().unwrap()),
        data: Some(PathBuf::from("/some where/ö")),
        ..ServeFlags::default()
    };
    let config = merge(text, &list, &flags).unwrap();
    assert_eq!(config.http.to_string(), "127.0.0.1:0");
    assert_eq!(config.data, PathBuf::from("/some where/ö"));
    assert_eq!(config.queue_changes_max.get(), 2);
    assert_eq!(config.body_bytes_max.get(), 1);
    assert_eq!(config.log_format, LogFormat::Json);
    assert_eq!(config.log_filter, "debug");
    assert_eq!(
        config.change_cubes_max,
        ServeConfig::default().change_cubes_max
    );
}

#[test]
fn an_unknown_key_of_the_file_is_refused_by_name() {
    let text = "# a comment\nhttp = '127.0.0.1:1'\n\nhtp = '127.0.0.1:1'\n";
    let error = merge(text, &[], &ServeFlags::default()).unwrap_err();
    assert!(error.contains("union3d.toml, line 4: htp"), "{error}");
}

#[test]
fn variables_of_others_are_left_alone() {
    let list = [
        ("UNION3D_PORT_7373_TCP", "tcp://10.0.0.1:7373"),
        ("UNION3D_CONFIG", "x.toml"),
        ("UNION3D_KEY", "u3d_0"),
        ("UNION3D_SERVICE_HOST", "10.0.0.1"),
        ("UNION3D_SERVICE_PORT_GRPC", "7374"),
        ("UNION3D_EDGE_PORT", "tcp://10.0.0.1:7373"),
        ("UNION3D_HTTP", ""),
        ("PATH", "/bin"),
    ];
    assert_eq!(
        merge("", &list, &ServeFlags::default()),
        Ok(ServeConfig::default())
    );
}

#[test]
fn a_value_out_of_range_is_refused_with_its_key() {
    for (text, key) in [
        ("queue_changes_max = 0", "queue_changes_max"),
        ("queue_changes_max = -5", "queue_changes_max"),
        ("http = 'localhost'", "http"),
        (
            "allowed_host = ['union3d.example', 'http://x']",
            "allowed_host",
        ),
        ("allow_origin = ['localhost:3000']", "allow_origin"),
        ("log_format = 'xml'", "log_format"),
        ("change_cubes_max = 100000000", "change_cubes_max"),
    ] {
        let error = merge(text, &[], &ServeFlags::default()).unwrap_err();
        assert!(error.contains(key), "{text}: {error}");
    }
    let list = [("UNION3D_BODY_BYTES_MAX", "many")];
    let error = merge("", &list, &ServeFlags::default()).unwrap_err();
    assert!(error.contains("body_bytes_max"), "{error}");
}

#[test]
fn a_file_that_is_not_there_is_refused_by_name() {
    let missing = PathBuf::from("/nowhere/union3d.toml");
    let error = ServeConfig::merge(Some(&missing), [], &ServeFlags::default()).unwrap_err();
    assert!(
        error.to_string().contains("/nowhere/union3d.toml"),
        "{error}"
    );
}

#[test]
fn a_certificate_without_its_key_is_refused() {
    for (text, key) in [
        ("tls_certificate = 'a'", "tls_key"),
        ("tls_key = 'a'", "tls_certificate"),
        ("tls_client_ca = 'a'", "tls_certificate"),
    ] {
        let error = merge(text, &[], &ServeFlags::default()).unwrap_err();
        assert!(error.contains(key), "{text}: {error}");
    }
    let list = [("UNION3D_TLS_KEY", "b")];
    let config = merge("tls_certificate = 'a'", &list, &ServeFlags::default()).unwrap();
    let files = config.certificates().unwrap();
    assert_eq!(files.certificate, PathBuf::from("a"));
    assert_eq!(files.key, PathBuf::from("b"));
    assert_eq!(files.client_ca, None);
}

#[test]
fn an_unknown_variable_is_refused_by_name() {
    let error = merge("", &[("UNION3D_HTPP", "secret")], &ServeFlags::default()).unwrap_err();
    assert!(
        error.contains("UNION3D_HTPP") && !error.contains("secret"),
        "{error}"
    );
}

/// Lists stand in the file as lists, and in a variable with commas between.
#[test]
fn lists_come_from_everywhere() {
    let names = |config: &ServeConfig| -> Vec<String> {
        config
            .allowed_host
            .iter()
            .cloned()
            .map(String::from)
            .collect()
    };
    let none = ServeFlags::default();
    let text =
        "allowed_host = ['a.example', 'B.example']\nallow_origin = ['http://localhost:3000']";
    let config = merge(text, &[], &none).unwrap();
    assert_eq!(names(&config), ["a.example", "b.example"]);
    assert_eq!(
        config.allow_origin,
        ["http://localhost:3000".parse().unwrap()]
    );
    let config = merge(
        text,
        &[("UNION3D_ALLOWED_HOST", "c.example,d.example")],
        &none,
    )
    .unwrap();
    assert_eq!(names(&config), ["c.example", "d.example"]);
    let config = merge(text, &[("UNION3D_ALLOWED_HOST", "c.example")], &none).unwrap();
    assert_eq!(names(&config), ["c.example"]);
    let flags = ServeFlags {
        allowed_host: vec!["e.example".parse().unwrap()],
        ..none
    };
    assert_eq!(names(&merge(text, &[], &flags).unwrap()), ["e.example"]);
}

#[test]
fn addresses_are_numbers_names_or_all() {
    for (written, shown) in [
        ("127.0.0.1:7373", "127.0.0.1:7373"),
        ("[::1]:0", "[::1]:0"),
        ("localhost:7373", "localhost:7373"),
        (":7373", ":7373"),
    ] {
        let config = merge(&format!("http = '{written}'"), &[], &ServeFlags::default()).unwrap();
        assert_eq!(config.http.to_string(), shown);
    }
    for wrong in [
        "",
        "7373",
        "localhost",
        "localhost:",
        "localhost:70000",
        "::1:7373",
        "http://x:1",
        "a b:1",
        ":+1",
    ] {
        let refused = merge(&format!("http = '{wrong}'"), &[], &ServeFlags::default());
        assert!(refused.unwrap_err().contains("http"), "{wrong}");
    }
}
