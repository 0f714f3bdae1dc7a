"""What PS3.15, A.5.1.1 allows in an audit message, written from the standard's schema; shares nothing with the node."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from xml.etree import ElementTree

ANY, NUMBER, BASE64 = r".+", r"[0-9]+", r"(?:[A-Za-z0-9+/]{4})*(?:[A-Za-z0-9+/]{2}==|[A-Za-z0-9+/]{3}=)?"
TIME = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d+)?(Z|[+-]\d\d:\d\d)"
CODED = {"csd-code": ANY, "codeSystemName": ANY, "originalText": ANY}
ATTRIBUTES: dict[str, dict[str, str]] = {
    "AuditMessage": {},
    "EventIdentification": {
        "EventActionCode": "[CRUDE]",
        "EventDateTime": TIME,
        "EventOutcomeIndicator": "0|4|8|12",
    },
    "EventID": CODED,
    "EventTypeCode": CODED,
    "EventOutcomeDescription": {},
    "ActiveParticipant": {
        "UserID": ANY,
        "UserIsRequestor": "true|false",
        "AlternativeUserID?": ANY,
        "NetworkAccessPointID?": ANY,
        "NetworkAccessPointTypeCode?": "[1-5]",
    },
    "RoleIDCode": CODED,
    "AuditSourceIdentification": {"AuditSourceID": ANY},
    "AuditSourceTypeCode": {"csd-code": "[1-9]"},
    "ParticipantObjectIdentification": {
        "ParticipantObjectID": ANY,
        "ParticipantObjectTypeCode?": "[1-4]",
        "ParticipantObjectTypeCodeRole?": "[1-9]|1[0-9]|2[0-6]",
    },
    "ParticipantObjectIDTypeCode": CODED,
    "ParticipantObjectName": {},
    "ParticipantObjectDetail": {"type": ANY, "value": BASE64},
    "ParticipantObjectDescription": {},
    "SOPClass": {"UID?": r"[0-9.]+", "NumberOfInstances": NUMBER},
}
"""Elements that the node may use, with their attributes, each required but for those with a question mark."""

CHILDREN = {
    "AuditMessage": (
        r"EventIdentification (ActiveParticipant )+AuditSourceIdentification (ParticipantObjectIdentification )*"
    ),
    "EventIdentification": r"EventID (EventTypeCode )*(EventOutcomeDescription )?",
    "ActiveParticipant": r"(RoleIDCode )*",
    "AuditSourceIdentification": r"(AuditSourceTypeCode )*",
    "ParticipantObjectIdentification": (
        r"ParticipantObjectIDTypeCode ParticipantObjectName (ParticipantObjectDetail )*"
        r"(ParticipantObjectDescription )*"
    ),
    "ParticipantObjectDescription": r"(SOPClass )*",
}
"""Their children, in this order; others have none."""


@dataclass(frozen=True)
class Told:
    """What one message says."""

    event: str
    action: str
    outcome: str
    reason: str
    participants: list[str]
    study: str
    details: dict[str, str]
    count: int


def conforming(line: str) -> Told:
    """Return what a message says; fails the test where it breaks the schema."""
    message = ElementTree.fromstring(line)
    for element in message.iter():
        allowed = ATTRIBUTES[element.tag]
        assert set(element.attrib) <= {name.rstrip("?") for name in allowed}, line
        for name, pattern in allowed.items():
            value = element.attrib.get(name.rstrip("?"))
            assert value is not None or name.endswith("?"), (name, line)
            assert value is None or re.fullmatch(pattern, value), (name, value)
        children = "".join(f"{child.tag} " for child in element)
        assert re.fullmatch(CHILDREN.get(element.tag, ""), children), (element.tag, children)
    event = message[0]
    study = message.find("ParticipantObjectIdentification")
    return Told(
        event=event[0].attrib["csd-code"],
        action=event.attrib["EventActionCode"],
        outcome=event.attrib["EventOutcomeIndicator"],
        reason=event.findtext("EventOutcomeDescription", ""),
        participants=[one.attrib["UserID"] for one in message.iter("ActiveParticipant")],
        study="" if study is None else study.attrib["ParticipantObjectID"],
        details={
            one.attrib["type"]: base64.b64decode(one.attrib["value"]).decode()
            for one in message.iter("ParticipantObjectDetail")
        },
        count=sum(int(one.attrib["NumberOfInstances"]) for one in message.iter("SOPClass")),
    )
