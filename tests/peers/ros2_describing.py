"""A DDS peer that publishes a type of its own as a node of ROS 2 (Iron or later) with rmw_cyclonedds would, and answers for its
definition (~/get_type_description, REP 2016): Eclipse Cyclone DDS with ROS 2's names, types and QoS.

usage: ros2_describing.py HOW

Publishes rig_msgs/msg/Grip on /grip ten times a second as node /hand. HOW `honest`: the definition is what it announces;
`lying`: a field in it has another name; `refusing`: there is none. Prints one line of JSON when it is ready, and one for each
request; stays until it is ended.
"""

import json
import sys
import time
from dataclasses import dataclass

from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.types import array, sequence, uint8, uint64
from cyclonedds.pub import DataWriter
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from ros2_publisher import Header, Time

# By rosbags 0.11.9, of SOURCES.
HASH = "RIHS01_3e789e2509f81d797131bc8cbc2e060199fd1af28e8d4a51b73e5e6adc25b74d"
GRIP = "rig_msgs/msg/Grip"
SOURCES = {
    "builtin_interfaces/msg/Time": "# A time.\nint32 sec\nuint32 nanosec\n",
    "std_msgs/msg/Header": "builtin_interfaces/Time stamp\nstring frame_id\n",
    GRIP: "std_msgs/Header header\nfloat64 force # newton\nstring<=16 label\n",
}


@dataclass
class Grip(IdlStruct, typename="rig_msgs.msg.dds_.Grip_"):
    header: Header
    force: float
    label: str


@dataclass
class Gid(IdlStruct, typename="rmw_dds_common.msg.dds_.Gid_"):
    data: array[uint8, 16]


@dataclass
class NodeEntitiesInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.NodeEntitiesInfo_"):
    node_namespace: str
    node_name: str
    reader_gid_seq: sequence[Gid]
    writer_gid_seq: sequence[Gid]


@dataclass
class ParticipantEntitiesInfo(IdlStruct, typename="rmw_dds_common.msg.dds_.ParticipantEntitiesInfo_"):
    gid: Gid
    node_entities_info_seq: sequence[NodeEntitiesInfo]


# rmw_cyclonedds writes these two numbers before the request and before the answer.
@dataclass
class Request(IdlStruct, typename="type_description_interfaces.srv.dds_.GetTypeDescription_Request_"):
    client: uint64
    number: uint64
    type_name: str
    type_hash: str
    include_type_sources: bool


@dataclass
class FieldType(IdlStruct, typename="type_description_interfaces.msg.dds_.FieldType_"):
    type_id: uint8
    capacity: uint64
    string_capacity: uint64
    nested_type_name: str


@dataclass
class Field(IdlStruct, typename="type_description_interfaces.msg.dds_.Field_"):
    name: str
    type: FieldType
    default_value: str


@dataclass
class IndividualTypeDescription(IdlStruct, typename="type_description_interfaces.msg.dds_.IndividualTypeDescription_"):
    type_name: str
    fields: sequence[Field]


@dataclass
class TypeDescription(IdlStruct, typename="type_description_interfaces.msg.dds_.TypeDescription_"):
    type_description: IndividualTypeDescription
    referenced_type_descriptions: sequence[IndividualTypeDescription]


@dataclass
class TypeSource(IdlStruct, typename="type_description_interfaces.msg.dds_.TypeSource_"):
    type_name: str
    encoding: str
    raw_file_contents: str


@dataclass
class KeyValue(IdlStruct, typename="type_description_interfaces.msg.dds_.KeyValue_"):
    key: str
    value: str


@dataclass
class Response(IdlStruct, typename="type_description_interfaces.srv.dds_.GetTypeDescription_Response_"):
    client: uint64
    number: uint64
    successful: bool
    failure_reason: str
    type_description: TypeDescription
    type_sources: sequence[TypeSource]
    extra_information: sequence[KeyValue]


def say(**what):
    print(json.dumps(what), flush=True)


def described():
    """The parts of the structured description that have more than one shape; a reader skips them."""
    nested = FieldType(1, 0, 0, "std_msgs/msg/Header")
    fields = [Field("header", nested, ""), Field("force", FieldType(11, 0, 0, ""), "0.5")]
    fields.append(Field("label", FieldType(21, 0, 16, ""), ""))
    others = [IndividualTypeDescription(name, []) for name in SOURCES if name != GRIP]
    return TypeDescription(IndividualTypeDescription(GRIP, fields), others)


def answer(request, how):
    if how == "refusing" or request.type_name != GRIP or request.type_hash != HASH:
        nothing = TypeDescription(IndividualTypeDescription("", []), [])
        return Response(request.client, request.number, False, "not known here", nothing, [], [])
    sources = dict(SOURCES)
    if how == "lying":
        sources[GRIP] = sources[GRIP].replace("force", "power")
    listed = [TypeSource(name, "msg", text) for name, text in sources.items()]
    return Response(request.client, request.number, True, "", described(), listed, [KeyValue("made", "by hand")])


def main():
    how = sys.argv[1]
    participant = DomainParticipant(0)
    reliable, volatile = Policy.Reliability.Reliable(duration(seconds=10)), Policy.Durability.Volatile
    # As an rmw: what names nodes is there before any of them.
    kept = Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))
    graph = DataWriter(participant, Topic(participant, "ros_discovery_info", ParticipantEntitiesInfo, qos=kept), qos=kept)
    service = Qos(reliable, volatile, Policy.History.KeepLast(10))
    requests = DataReader(participant, Topic(participant, "rq/hand/get_type_descriptionRequest", Request), qos=service)
    answers = DataWriter(participant, Topic(participant, "rr/hand/get_type_descriptionReply", Response), qos=service)
    announced = Qos(reliable, volatile, Policy.History.KeepLast(100), Policy.Userdata(f"typehash={HASH};".encode()))
    grips = DataWriter(participant, Topic(participant, "rt/grip", Grip), qos=announced)
    gid = lambda entity: Gid(list(entity.guid.bytes))
    node = NodeEntitiesInfo("/", "hand", [gid(requests)], [gid(answers), gid(grips)])
    graph.write(ParticipantEntitiesInfo(gid(participant), [node]))
    say(ready=True)
    number = 0
    while True:
        number += 1
        grips.write(Grip(Header(Time(number, 0), "hand"), number + 0.25, f"grip {number}"))
        for request in requests.take(10):
            say(asked=request.type_name)
            answers.write(answer(request, how))
        time.sleep(0.1)


if __name__ == "__main__":
    main()
