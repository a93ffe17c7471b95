"""What a run of a pipeline of manifest.py said, with the answers: the lists of docs/concealed.md, or with --sums the numbers of docs/diagnosis.md.

    python3 data/concealed/summary.py out/concealed DIR/answers-blind.json
    python3 data/concealed/summary.py out/concealed DIR/answers-blind.json --sums
"""

import argparse
import json
import pathlib
import statistics
import sys

KINDS = [("One effect", ("single",)), ("Two effects", ("pair",)), ("In no catalogue", ("off_catalogue",)), ("Nothing", ("null", "hard_null", "trap"))]
CLAIMS = ("named", "ambiguous", "unnamed")
# Families of the plan `field` in which one picture moves; in the others nothing does as one.
COHERENT = ("texture", "photograph", "star", "text")
# Detection limits of known light from which on an effect is expected to be seen without it.
EXPECTED = 5.0


def read(run, answers):
    """(name, answer, pooled metrics) of every recording of the answers that the run scored."""
    try:
        truth = {pathlib.Path(one["file"]).stem: one for one in json.loads(pathlib.Path(answers).read_text())["recordings"]}
        lines = (pathlib.Path(run) / "metrics.pooled.jsonl").read_text().splitlines()
    except (OSError, ValueError, KeyError, TypeError) as error:
        sys.exit(f"{run}, {answers}: not a run of manifest.py's pipeline and its answers ({type(error).__name__}: {error})")
    said = {}
    for score in map(json.loads, lines):
        one = said.setdefault(score["variant"].split("=")[1], {})
        one[score["metric"]] = score["value"]
        one["card"] = dict(pair.split(" = ") for pair in score["card"].split(": ", 1)[1].split("; "))
    missing = truth.keys() - said.keys()
    if missing:
        sys.exit(f"{run}: no score of {len(missing)} recordings of {answers}, such as {min(missing)}; run the pipeline of these answers, whole")
    return [(name, truth[name], said[name]) for name in truth]


def truth_of(answer, card):
    """What is in a recording, in words."""
    outside = answer.get("off_catalogue")
    if outside:
        return outside.get("law") or outside.get("plain") or outside.get("words") or str(outside.get("covariates"))
    if answer["kind"] in ("single", "pair"):
        return card["truth"].replace("+", ", ")
    return "nothing" if answer["kind"] == "null" else "nothing: " + (answer.get("condition") or answer["kind"])


def size_of(answer):
    """Effect size of a recording with one effect: over the least that is drawn, or in the plan `field` over the detection limit."""
    return answer.get("at_limit") or (answer["effects"][0].get("times") if answer["kind"] == "single" else None)


def said_of(card):
    verdict, said = card["verdict"], card["said"]
    if said in ("none", "-", ""):
        return f"`{verdict}`"
    return said.replace("+", ", ") + ("" if verdict in ("named", "unnamed") else f" (`{verdict}`)")


def lists(recordings):
    for title, kinds in KINDS:
        rows = []
        for name, answer, metrics in recordings:
            if answer["kind"] in kinds:
                size = f"{size_of(answer):.1f}" if size_of(answer) else ""
                error = f"{metrics['parameter_error']:.1f}" if metrics.get("parameter_error") is not None else ""
                said = said_of(metrics["card"])
                if metrics.get("unnamed"):
                    said += ", right covariate" if metrics.get("covariate_right") else ", another covariate"
                rows.append((truth_of(answer, metrics["card"]), name, size, said, error))
        if rows:
            print(f"**{title}**\n\n| recording | truth | effect size | said | error, % |\n| --- | --- | ---: | --- | ---: |")
            print("\n".join(f"| {name} | {truth} | {size} | {said} | {error} |" for truth, name, size, said, error in sorted(rows)) + "\n")


def sums(recordings):
    of = lambda kinds: [one for one in recordings if one[1]["kind"] in kinds]
    total = lambda some, metric: round(sum(metrics.get(metric) or 0 for *_, metrics in some), 2)
    verdict = lambda some, verdicts: sum(metrics["card"]["verdict"] in verdicts for *_, metrics in some)
    none, single, pair, off = (of(kinds) for kinds in (KINDS[3][1], ("single",), ("pair",), ("off_catalogue",)))
    strong = [one for one in single if (size_of(one[1]) or 0) >= 3]
    named = [one for one in recordings if one[2]["card"]["verdict"] == "named"]
    true = lambda one: set(one[2]["card"]["said"].split("+")) <= set(one[2]["card"]["truth"].split("+"))
    for title, is_one in (("one picture moves", True), ("nothing moves as one", False)):
        here = [one for one in recordings if "times" in (one[1].get("effects") or [{}])[0] and (one[1]["scene"]["family"] in COHERENT) == is_one]
        seen = [one for one in here if one[1]["kind"] == "single" and one[1]["effects"][0]["times"] >= EXPECTED]
        if here:
            first, found = total(seen, "first_right"), total(seen, "in_set")
            print(f"{title}, five times the detection limit of known light and more: claimed {verdict(seen, CLAIMS)}, first {first:g}, in the set {found:g} of {len(seen)}")
    errors = [metrics["parameter_error"] for *_, metrics in recordings if metrics.get("parameter_error") is not None]
    print(f"false alarms: {total(none, 'false_alarm'):g} of {len(none)}")
    print(f"one effect: claimed {verdict(single, CLAIMS)}, first {total(single, 'first_right'):g}, in the set {total(single, 'in_set'):g} of {len(single)}; surplus names {total(single, 'surplus'):g}")
    print(f"one effect of three times the limit and more: first {total(strong, 'first_right'):g} of {len(strong)}")
    print(f"two effects: mean F1 {total(pair, 'f1') / max(len(pair), 1):.2f} ({len(pair)})")
    unnamed = lambda some: f"unnamed {total(some, 'unnamed'):g}, with a right covariate {total(some, 'covariate_right'):g}, named {verdict(some, ('named', 'ambiguous'))} of {len(some)}"
    print(f"in no catalogue: {unnamed(off)}")
    for title, is_one in (("one picture moves", True), ("nothing moves as one", False)):
        here = [one for one in off if "form" in one[1]["off_catalogue"] and (one[1]["scene"]["family"] in COHERENT) == is_one]
        if here:
            print(f"  {title}: {unnamed(here)}")
    print(f"verdict named, every name true: {sum(map(true, named))} of {len(named)}")
    print(f"nothing decided: {verdict(recordings, ('insufficient',))} of {len(recordings)}, {verdict(single, ('insufficient',))} of them with one effect")
    print(f"error of the parameter, median: {statistics.median(errors):.1f} % of {len(errors)}" if errors else "no parameter was found")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", help="output folder of the run")
    parser.add_argument("answers", help="the answer file that its pipeline was made of")
    parser.add_argument("--sums", action="store_true", help="counts instead of lists")
    arguments = parser.parse_args()
    (sums if arguments.sums else lists)(read(arguments.run, arguments.answers))


if __name__ == "__main__":
    main()
