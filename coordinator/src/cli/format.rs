//! Numbers, times and tables as people read them.

use gatherlight_proto::limits::MAX_TIME_LIMIT;
use std::time::Duration;

/// 1234567.0 → `1.23 M`; three digits, factors of a thousand.
pub(crate) fn count(value: f64) -> String {
    scaled(value, 1000.0, &["", " k", " M", " G", " T", " P"])
}

/// 1536.0 → `1.50 KiB`.
pub(crate) fn bytes(value: u64) -> String {
    scaled(value as f64, 1024.0, &[" B", " KiB", " MiB", " GiB", " TiB", " PiB"])
}

/// `64G` → bytes; K, M, G and T are powers of 1024.
pub(crate) fn parse_bytes(text: &str) -> Result<u64, String> {
    let unit = text.trim_start_matches(|c: char| c.is_ascii_digit());
    let shift = match unit.to_ascii_uppercase().as_str() {
        "" | "B" => 0,
        "K" | "KB" | "KIB" => 10,
        "M" | "MB" | "MIB" => 20,
        "G" | "GB" | "GIB" => 30,
        "T" | "TB" | "TIB" => 40,
        _ => return Err(format!("{text:?} is no size; write a whole number, with K, M, G or T behind it")),
    };
    let number: u64 = text[..text.len() - unit.len()]
        .parse()
        .map_err(|_| format!("{text:?} is no size; write a whole number, with K, M, G or T behind it"))?;
    number.checked_mul(1 << shift).ok_or_else(|| format!("{text} is more than 16 EiB"))
}

fn scaled(mut value: f64, factor: f64, units: &[&str]) -> String {
    if !value.is_finite() {
        return "?".into();
    }
    let mut unit = 0;
    // 999.5 would be written 1000.
    while value.abs() >= 999.5 && unit + 1 < units.len() {
        value /= factor;
        unit += 1;
    }
    let digits = match value.abs() {
        _ if unit == 0 && value.fract() == 0.0 => 0,
        v if v < 9.995 => 2,
        v if v < 99.95 => 1,
        _ => 0,
    };
    format!("{value:.digits$}{}", units.get(unit).unwrap_or(&""))
}

/// 1234567 → `1,234,567`.
pub(crate) fn grouped(value: u64) -> String {
    let digits = value.to_string();
    let mut text = String::new();
    for (i, d) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            text.push(',');
        }
        text.push(d);
    }
    text
}

/// `0.42 s`, `12.3 s`, `2 min 05 s`, `3 h 07 min`, `2 d 04 h`.
pub(crate) fn duration(d: Duration) -> String {
    let s = d.as_secs_f64();
    let whole = s.round() as u64;
    match whole {
        _ if s < 9.995 => format!("{s:.2} s"),
        _ if s < 59.95 => format!("{s:.1} s"),
        0..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        3600..86_400 => format!("{} h {:02} min", whole / 3600, whole % 3600 / 60),
        _ => format!("{} d {:02} h", whole / 86_400, whole % 86_400 / 3600),
    }
}

/// `90`, `1.5s`, `200ms`, `5m`, `1h30m`, `2d` → a duration; a number alone is in seconds.
pub(crate) fn parse_duration(text: &str) -> Result<Duration, String> {
    let explain = || format!("{text:?} is no time; write one such as 30s, 5m, 1h30m or 2d");
    let mut rest: String = text.chars().filter(|c| !c.is_whitespace()).collect();
    let mut seconds = 0.0;
    while !rest.is_empty() {
        let number = rest.find(|c: char| !c.is_ascii_digit() && c != '.').unwrap_or(rest.len());
        let tail = rest.split_off(number);
        let unit = tail.find(|c: char| c.is_ascii_digit() || c == '.').unwrap_or(tail.len());
        let factor = match &tail[..unit] {
            "ms" => 1e-3,
            "" | "s" | "sec" => 1.0,
            "m" | "min" => 60.0,
            "h" => 3_600.0,
            "d" => 86_400.0,
            _ => return Err(explain()),
        };
        seconds += rest.parse::<f64>().map_err(|_| explain())? * factor;
        rest = tail[unit..].to_owned();
    }
    let time = Duration::try_from_secs_f64(seconds).map_err(|_| explain())?;
    // The wire counts milliseconds.
    if time < Duration::from_millis(1) || time > MAX_TIME_LIMIT {
        return Err(format!("{text:?} is outside 1ms … {}d", MAX_TIME_LIMIT.as_secs() / 86_400));
    }
    Ok(time)
}

/// Columns aligned at the left, two spaces apart, without trailing spaces; `header` first.
pub(crate) fn table(header: &[&str], rows: &[Vec<String>]) -> String {
    let header: Vec<String> = header.iter().map(|h| h.to_string()).collect();
    let lines = || std::iter::once(&header).chain(rows);
    let columns = header.len();
    let width = |c: usize| lines().filter_map(|l| l.get(c)).map(|t| t.chars().count()).max().unwrap_or(0);
    let widths: Vec<usize> = (0..columns).map(width).collect();
    let mut text = String::new();
    for line in lines() {
        let cells: Vec<String> = line.iter().zip(&widths).map(|(t, w)| format!("{t:<w$}")).collect();
        text.push_str(cells.join("  ").trim_end());
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_well() {
        let counts = [0.0, 7.0, 7.5, 999.0, 999.6, 12_345.0, 1.0e6, 1.234e12].map(count);
        assert_eq!(counts, ["0", "7", "7.50", "999", "1.00 k", "12.3 k", "1.00 M", "1.23 T"]);
        assert_eq!(count(f64::NAN), "?");
        assert_eq!([0, 1023, 1536, 5 << 30].map(bytes), ["0 B", "1.00 KiB", "1.50 KiB", "5.00 GiB"]);
        assert_eq!([0, 999, 1000, 1_234_567].map(grouped), ["0", "999", "1,000", "1,234,567"]);
    }

    #[test]
    fn sizes_take_suffixes() {
        assert_eq!(["0", "12", "3k", "64G", "1TiB"].map(|t| parse_bytes(t).unwrap()), [0, 12, 3072, 64 << 30, 1 << 40]);
        for bad in ["", "G", "1.5G", "-1", "1X", "99999999999T"] {
            assert!(parse_bytes(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn times_take_units() {
        let good = ["90", "1.5s", "200ms", "5m", "5 min", "1h30m", "2d", "1m0.5s"].map(|t| parse_duration(t).unwrap());
        assert_eq!(good.map(|d| d.as_millis()), [90_000, 1_500, 200, 300_000, 300_000, 5_400_000, 172_800_000, 60_500]);
        for bad in ["", "s", "-1s", "1x", "0", "0.0001s", "1.2.3s", "nan", "inf", "1e9s", "9999d", "m5"] {
            assert!(parse_duration(bad).is_err(), "{bad}");
        }
    }

    #[test]
    fn durations_read_well() {
        let d = |s: f64| duration(Duration::from_secs_f64(s));
        assert_eq!(
            [d(0.4217), d(12.34), d(59.96), d(125.0), d(11_240.0), d(200_000.0)],
            ["0.42 s", "12.3 s", "1 min 00 s", "2 min 05 s", "3 h 07 min", "2 d 07 h"]
        );
    }

    #[test]
    fn tables_align() {
        let rows = vec![vec!["a".to_string(), "ß…".into()], vec!["bcd".into(), "x".into()]];
        assert_eq!(table(&["id", "name"], &rows), "id   name\na    ß…\nbcd  x\n");
    }
}
