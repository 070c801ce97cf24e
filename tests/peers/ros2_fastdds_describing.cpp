// What ros2_describing.py does honestly, by eProsima Fast DDS as rmw_fastrtps would: an answer names its request by the identity of
// a sample beside it, and goes out when the asking subscriber has been met.
//
// usage: ros2_fastdds_describing

#include <chrono>
#include <cstdio>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "ros2_fastdds.hpp"

// By rosbags 0.11.9, of the sources below.
static const char *HASH = "RIHS01_3e789e2509f81d797131bc8cbc2e060199fd1af28e8d4a51b73e5e6adc25b74d";
static const char *GRIP = "rig_msgs/msg/Grip";

// Lengths are counted from behind the header of four bytes.
static void put_long(Bytes &bytes, uint64_t number) {
    while ((bytes.size() - 4) % 8 != 0) bytes.push_back(0);
    for (int shift = 0; shift < 64; shift += 8) bytes.push_back(static_cast<uint8_t>(number >> shift));
}

static void put_field(Bytes &bytes, const std::string &name, uint8_t type, const std::string &nested) {
    put_text(bytes, name);
    bytes.push_back(type);
    put_long(bytes, 0);
    put_long(bytes, type == 21 ? 16 : 0);
    put_text(bytes, nested);
    put_text(bytes, "");
}

static void put_source(Bytes &bytes, const std::string &name, const std::string &text) {
    put_text(bytes, name);
    put_text(bytes, "msg");
    put_text(bytes, text);
}

static Bytes answer() {
    Bytes bytes = {0, 1, 0, 0, 1};
    put_text(bytes, "");
    put_text(bytes, GRIP);
    put_number(bytes, 3);
    put_field(bytes, "header", 1, "std_msgs/msg/Header");
    put_field(bytes, "force", 11, "");
    put_field(bytes, "label", 21, "");
    put_number(bytes, 0);
    put_number(bytes, 3);
    put_source(bytes, "builtin_interfaces/msg/Time", "# A time.\nint32 sec\nuint32 nanosec\n");
    put_source(bytes, GRIP, "std_msgs/Header header\nfloat64 force # newton\nstring<=16 label\n");
    put_source(bytes, "std_msgs/msg/Header", "builtin_interfaces/Time stamp\nstring frame_id\n");
    put_number(bytes, 0);
    return bytes;
}

static void put_id(Bytes &bytes, const rtps::GUID_t &id) {
    bytes.insert(bytes.end(), id.guidPrefix.value, id.guidPrefix.value + 12);
    bytes.insert(bytes.end(), id.entityId.value, id.entityId.value + 4);
}

// rmw_dds_common/msg/ParticipantEntitiesInfo since Iron.
static Bytes graph(const rtps::GUID_t &participant, const rtps::GUID_t &requests, const rtps::GUID_t &answers,
                   const rtps::GUID_t &grips) {
    Bytes bytes = {0, 1, 0, 0};
    put_id(bytes, participant);
    put_number(bytes, 1);
    put_text(bytes, "/");
    put_text(bytes, "hand");
    put_number(bytes, 1);
    put_id(bytes, requests);
    put_number(bytes, 2);
    put_id(bytes, answers);
    put_id(bytes, grips);
    return bytes;
}

static Bytes grip(uint32_t number) {
    Bytes bytes = {0, 1, 0, 0};
    put_number(bytes, number);
    put_number(bytes, 0);
    put_text(bytes, "hand");
    const double force = number + 0.25;
    uint64_t bits;
    std::memcpy(&bits, &force, 8);
    put_long(bytes, bits);
    put_text(bytes, "grip " + std::to_string(number));
    align(bytes);
    return bytes;
}

int main() {
    auto *participant = fast::DomainParticipantFactory::get_instance()->create_participant(0, fast::PARTICIPANT_QOS_DEFAULT);
    if (participant == nullptr) return 1;
    auto *publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    auto *subscriber = participant->create_subscriber(fast::SUBSCRIBER_QOS_DEFAULT);
    const auto topic = [&](const std::string &name, const std::string &type_name) {
        fast::TypeSupport type(new Raw(type_name, 1 << 16));
        type.register_type(participant);
        return participant->create_topic(name, type_name, fast::TOPIC_QOS_DEFAULT);
    };
    fast::DataWriterQos writes = fast::DATAWRITER_QOS_DEFAULT;
    writes.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    // As rmw_fastrtps: what names nodes is there before any of them.
    writes.durability().kind = fast::TRANSIENT_LOCAL_DURABILITY_QOS;
    writes.history().depth = 1;
    auto *nodes = publisher->create_datawriter(
        topic("ros_discovery_info", "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"), writes);
    writes.history().depth = 10;
    fast::DataReaderQos reads = fast::DATAREADER_QOS_DEFAULT;
    reads.reliability().kind = fast::RELIABLE_RELIABILITY_QOS;
    reads.history().depth = 10;
    const std::string service = "type_description_interfaces::srv::dds_::GetTypeDescription_";
    auto *requests = subscriber->create_datareader(topic("rq/hand/get_type_descriptionRequest", service + "Request_"), reads);
    writes.durability().kind = fast::VOLATILE_DURABILITY_QOS;
    auto *answers = publisher->create_datawriter(topic("rr/hand/get_type_descriptionReply", service + "Response_"), writes);
    fast::DataWriterQos announced = writes;
    const std::string user_data = std::string("typehash=") + HASH + ";";
    announced.user_data().assign(user_data.begin(), user_data.end());
    auto *grips = publisher->create_datawriter(topic("rt/grip", "rig_msgs::msg::dds_::Grip_"), announced);
    if (requests == nullptr || answers == nullptr || grips == nullptr || nodes == nullptr) return 1;
    Bytes about = graph(participant->guid(), requests->guid(), answers->guid(), grips->guid());
    nodes->write(&about);
    std::printf("{\"ready\": true}\n");
    std::fflush(stdout);
    for (uint32_t number = 1;; ++number) {
        Bytes message = grip(number);
        grips->write(&message);
        Bytes request;
        fast::SampleInfo info;
        while (requests->take_next_sample(&request, &info) == ReturnCode_t::RETCODE_OK) {
            if (!info.valid_data) continue;
            std::printf("{\"asked\": \"%s\"}\n", GRIP);
            std::fflush(stdout);
            rtps::WriteParams beside;
            const auto &wanted = info.related_sample_identity.writer_guid();
            const bool is_wanted = wanted != rtps::GUID_t::unknown();
            beside.related_sample_identity().writer_guid() = is_wanted ? wanted : info.sample_identity.writer_guid();
            beside.related_sample_identity().sequence_number() = info.sample_identity.sequence_number();
            Bytes text = answer();
            answers->write(&text, beside);
        }
        std::this_thread::sleep_for(std::chrono::milliseconds(100));
    }
}
