"""The graph of contacts of a recording: transitions between contacts, with number and times (GraphML)."""

from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from contact_tracker.map.elements import KINDS
from contact_tracker.map.world_map import GrowingMap
from contact_tracker.outputs.outcome import Outcome
from contact_tracker.sequences.steps import Step, steps_of
from contact_tracker.states import Contact

_NAMESPACE: Final = "http://graphml.graphdrawing.org/xmlns"


@dataclass
class Node:
    """A contact with its touching elements, ``?`` for unknown ones, or a contact that the motion leaves open;
    ``spans_s`` are the times of its segments since the first pose."""

    contact: Contact
    is_open: bool
    elements: tuple[str, str]
    spans_s: list[tuple[float, float]] = field(default_factory=list)

    @property
    def total_s(self) -> float:
        """Total duration (s) of its segments."""
        return sum(end_s - start_s for start_s, end_s in self.spans_s)

    @property
    def name(self) -> str:
        """The contact, with ``?`` if it is open."""
        return f"{self.contact.value}{'?' * self.is_open}"

    @property
    def label(self) -> str:
        """``e-f: edge 3 on face 1``."""
        return ": ".join(filter(None, (self.name, " on ".join(filter(None, self.elements)))))


@dataclass
class ContactGraph:
    """``nodes`` in order of first occurrence, and the times (s) of transitions by pairs of node numbers."""

    nodes: list[Node]
    edges: dict[tuple[int, int], list[float]]

    @classmethod
    def of(cls, outcome: Outcome) -> "ContactGraph":
        """The graph of a recording."""
        nodes, edges = dict[tuple[object, ...], Node](), dict[tuple[int, int], list[float]]()
        sequence = list[tuple[tuple[object, ...], float]]()
        for step in steps_of(outcome):
            key = step.contact, step.is_open, _elements(step, outcome.learned_world)
            nodes.setdefault(key, Node(*key)).spans_s.append((step.start_s, step.end_s))
            sequence.append((key, step.start_s))
        numbers = {key: number for number, key in enumerate(nodes)}
        for (source, _), (target, start_s) in pairwise(sequence):
            if source != target:
                edges.setdefault((numbers[source], numbers[target]), []).append(start_s)
        return cls([*nodes.values()], edges)

    @property
    def graphml(self) -> str:
        """The graph as GraphML."""
        root = ElementTree.Element("graphml", xmlns=_NAMESPACE)
        for name, kind, owner in (
            ("label", "string", "node"),
            ("contact", "string", "node"),
            ("count", "int", "all"),
            ("seconds", "double", "node"),
            ("times_s", "string", "all"),
        ):
            keys = {"id": name, "for": owner, "attr.name": name, "attr.type": kind}
            ElementTree.SubElement(root, "key", keys)
        graph = ElementTree.SubElement(root, "graph", edgedefault="directed")
        elements = list[tuple[ElementTree.Element, dict[str, str], list[float]]]()
        for number, node in enumerate(self.nodes):
            values = {"label": node.label, "contact": node.name, "seconds": f"{node.total_s:.3f}"}
            element = ElementTree.SubElement(graph, "node", id=f"n{number}")
            elements.append((element, values, [start_s for start_s, _ in node.spans_s]))
        for (source, target), times_s in self.edges.items():
            element = ElementTree.SubElement(graph, "edge", source=f"n{source}", target=f"n{target}")
            elements.append((element, {}, times_s))
        for element, values, times_s in elements:
            times = " ".join(f"{time_s:.3f}" for time_s in times_s)
            for name, value in {**values, "count": str(len(times_s)), "times_s": times}.items():
                ElementTree.SubElement(element, "data", key=name).text = value
        ElementTree.indent(root)
        return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def write_graph(outcome: Outcome, path: Path, _: str) -> None:
    """Write the graph of a recording's contacts."""
    path.write_text(ContactGraph.of(outcome).graphml, encoding="utf-8")


def _elements(step: Step, world: GrowingMap | None) -> tuple[str, str]:
    """The touching elements, by the numbers of the map or by the user's names."""
    if step.contact is Contact.FREE or step.is_open:
        return "", ""
    names = [name or "?" for name in step.segment.touching]
    if step.sighting is not None and world is not None:
        pair = world.pairs[step.sighting.first]
        names = [f"{KINDS[kind]} {key[1]}" for kind, key in zip(step.sighting.kinds, pair, strict=True)]
    return names[0], names[1]
