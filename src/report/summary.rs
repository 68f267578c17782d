//! A summary of the results in a few sentences.

use super::html::escape;
use super::style::EQUAL;
use super::table::{self, Filter, Means, Row};
use crate::evaluate::results::Group;
use crate::metrics::Metric;
use crate::util::text::plural;

/// A paragraph about a set; empty where no method has a PSNR. Only rows that are means over the same sequences are compared.
pub fn paragraph(means: &Means, set: &str) -> String {
    let filter = Filter { set: Some(set), without_ablations: true, ..Filter::default() };
    let rows = means.rows(filter);
    let Some(psnr) = table::metric("psnr") else { return String::new() };
    let of = means.sequences(filter).len();
    let over = |row: &Row| means.over(filter, &row.method.id, psnr.id);
    let traced = |row: &&Row| row.method.group.is_traced();
    let keys = |row: &&Row| row.method.reads_keyframes;
    // Nobody says whether pictures from elsewhere read keyframes.
    let foreign = |row: &&Row| row.method.group == Group::Other;
    let say = |among: &str, wanted: &dyn Fn(&&Row) -> bool| {
        let rows = alike(rows.iter().filter(wanted).collect(), &over);
        winner(psnr, of, among, &rows)
    };
    let mut sentences = Vec::new();
    let plain = |row: &&Row| !traced(row) && !keys(row) && !foreign(row);
    sentences.extend(say("Without keyframes and without path tracing", &plain));
    let plain = alike(rows.iter().filter(plain).collect(), &over);
    if let Some((row, budget)) = best(&plain).and_then(|row| Some((row, row.seconds?))) {
        let fast = |other: &&Row| traced(other) && other.seconds.is_some_and(|s| s <= EQUAL * budget);
        let fast: Vec<&Row> = rows.iter().filter(fast).collect();
        // In these seconds, rows that read keyframes get the truth of them for free.
        let same: Vec<&Row> = fast.iter().copied().filter(|other| !keys(other) && over(other) == over(row)).collect();
        sentences.extend(match best(&same) {
            Some(other) => Some(format!("Path tracing in the same time ({}) is {}.", bold(other), gap(psnr, other, row))),
            None if fast.is_empty() => Some("No path-traced row is as fast.".into()),
            None => None,
        });
    }
    sentences.extend(say("With keyframes", &|row| !traced(row) && keys(row)));
    sentences.extend(say("Of the path-traced rows", &traced));
    sentences.extend(say("Of the pictures from elsewhere", &foreign));
    if sentences.is_empty() {
        return String::new();
    }
    format!("<p><strong>{}:</strong> {}</p>\n", escape(set), sentences.join(" "))
}

/// Those of `rows` that are means over the same sequences as the row with most sequences; `over` says which those are.
fn alike<'a, 'r>(rows: Vec<&'a Row<'r>>, over: &dyn Fn(&Row) -> Vec<usize>) -> Vec<&'a Row<'r>> {
    let most = rows.iter().map(|row| over(row)).max_by_key(Vec::len).unwrap_or_default();
    rows.into_iter().filter(|row| over(row) == most).collect()
}

/// What stands out of `rows`: the best of several, or the score of the only one. The set has `of` sequences.
fn winner(psnr: &Metric, of: usize, among: &str, rows: &[&Row]) -> Option<String> {
    let row = best(rows)?;
    let scored = rows.iter().filter(|row| row.mean("psnr").is_some()).count();
    Some(match scored {
        1 => format!("{} scores {}.", bold(row), result(psnr, of, row)),
        _ => format!("{among}, {} is best: {}.", bold(row), result(psnr, of, row)),
    })
}

/// The row with the highest PSNR.
fn best<'a, 'r>(rows: &[&'a Row<'r>]) -> Option<&'a Row<'r>> {
    let psnr = |row: &Row| row.mean("psnr");
    let scored = rows.iter().copied().filter(|row| psnr(row).is_some());
    scored.max_by(|a, b| psnr(a).unwrap_or(0.0).total_cmp(&psnr(b).unwrap_or(0.0)))
}

fn bold(row: &Row) -> String {
    format!("<em>{}</em>", escape(&row.method.label))
}

fn value(metric: &Metric, row: &Row) -> String {
    row.mean(metric.id).map_or_else(String::new, |mean| format!("{} dB", table::number(metric, mean)))
}

fn result(metric: &Metric, of: usize, row: &Row) -> String {
    let cell = row.cells.get(metric.id);
    let fewer = cell.map(|cell| cell.sequences).filter(|fewer| *fewer < of);
    let fewer = fewer.map_or_else(String::new, |fewer| format!(" over {fewer} of {}", plural(of, "sequence")));
    let ends = cell.and_then(|cell| cell.range);
    let ends = ends.map_or_else(String::new, |[a, b]| format!(" ({} to {})", table::number(metric, a), table::number(metric, b)));
    let seconds = row.seconds.map_or_else(String::new, |s| format!(" at {} s a frame", table::seconds(s)));
    let paid = row.seconds_with_truth.filter(|_| row.method.reads_keyframes);
    let paid = paid.map_or_else(String::new, |s| format!(", {} s with the truth of its keyframes", table::seconds(s)));
    format!("{}{ends}{fewer}{seconds}{paid}", value(metric, row))
}

/// By how much `row` is better or worse than another row.
fn gap(metric: &Metric, row: &Row, than: &Row) -> String {
    let gap = row.mean("psnr").unwrap_or(0.0) - than.mean("psnr").unwrap_or(0.0);
    let seconds = row.seconds.map_or_else(String::new, |s| format!(" at {} s a frame", table::seconds(s)));
    format!("{:.2} dB {}: {}{seconds}", gap.abs(), if gap < 0.0 { "worse" } else { "better" }, value(metric, row))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::results::{About, MethodInfo, Results, Score, Scored, SequenceSummary};

    /// A sequence with the PSNR of some methods, which took one second each.
    fn sequence(name: &str, scores: &[(&str, f64)]) -> Scored {
        let score = |(method, psnr): &(&str, f64)| Score {
            method: (*method).into(),
            frame: 1,
            key: false,
            seconds: Some(1.0),
            spp: None,
            values: [("psnr".to_owned(), *psnr)].into(),
        };
        Scored {
            about: SequenceSummary { set: "s".into(), name: name.into(), frames: vec![1], ..SequenceSummary::default() },
            pictures: std::path::PathBuf::new(),
            scores: scores.iter().map(score).collect(),
        }
    }

    fn results(sequences: Vec<Scored>) -> Results {
        let method = |id: &str, group, reads_keyframes| MethodInfo {
            reads_keyframes,
            ..MethodInfo::new(id.into(), id.to_uppercase(), group)
        };
        let methods = vec![
            method("ibl", Group::Baseline, false),
            method("net", Group::Neural, false),
            method("pt", Group::PathTraced, false),
            method("pt+keys", Group::PathTraced, true),
        ];
        let text = String::new;
        let about = About {
            version: 2,
            program: text(),
            title: text(),
            machine: text(),
            lpips: None,
            curve: text(),
            methods,
            settings: Vec::new(),
            sequences: None,
        };
        Results { about, sequences }
    }

    #[test]
    fn path_tracing_in_the_same_time_reads_no_keyframes() {
        let all = [("ibl", 20.0), ("net", 30.0), ("pt", 25.0), ("pt+keys", 40.0)];
        let results = results(vec![sequence("a", &all), sequence("b", &all)]);
        let text = paragraph(&Means::new(&results), "s");
        assert!(text.contains("same time (<em>PT</em>) is 5.00 dB worse"), "{text}");
        let keyed: Vec<_> = all.iter().copied().filter(|(id, _)| *id != "pt").collect();
        let results = self::results(vec![sequence("a", &keyed)]);
        let text = paragraph(&Means::new(&results), "s");
        assert!(!text.contains("same time") && !text.contains("is as fast"), "{text}");
    }

    #[test]
    fn only_means_over_the_same_sequences_are_compared() {
        // The network was scored on the easy sequence only.
        let easy = [("ibl", 30.0), ("net", 33.0), ("pt", 35.0)];
        let results = results(vec![sequence("easy", &easy), sequence("hard", &[("ibl", 20.0)])]);
        let means = Means::new(&results);
        let text = paragraph(&means, "s");
        assert!(text.contains("<em>IBL</em> scores 25.00 dB") && !text.contains("<em>NET</em>"), "{text}");
        assert!(!text.contains("same time"), "{text}");
        assert!(text.contains("<em>PT</em> scores 35.00 dB over 1 of 2 sequences at 1.00 s a frame"), "{text}");
        let table = table::markdown(&results, Filter::default());
        assert!(table.contains("| NET (1 of 2 sequences) |") && table.contains("| IBL "), "{table}");
        let rows = &table::json(&results)[0]["rows"];
        assert_eq!((&rows[0]["sequences"], &rows[1]["sequences"]), (&2.into(), &1.into()));
    }
}
