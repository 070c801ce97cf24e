// A second DDS peer that publishes as a ROS 2 node would: eProsima Fast DDS, as the distribution has it, with ROS 2's names.
//
// usage: ros2_fastdds TOPIC KIND COUNT HERTZ BYTES FILE [best_effort]
//
// KIND and BYTES are those of ros2_publisher.py. Every message, encapsulation header included, is also appended to FILE.
// Waits for a subscriber, publishes, prints one line of JSON about what it did, and stays until it is ended.

#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <string>
#include <thread>

#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/topic/Topic.hpp>
#include <fastdds/dds/topic/TypeSupport.hpp>

#include "ros2_fastdds.hpp"

static Bytes message(const std::string &kind, uint32_t number, size_t size) {
    Bytes bytes = {0, 1, 0, 0};
    if (kind == "string") {
        std::string text = std::to_string(number) + " ";
        text.resize(size, 'x');
        put_text(bytes, text);
    } else {
        put_number(bytes, number);
        put_number(bytes, 0);
        put_text(bytes, "camera");
        put_text(bytes, "jpeg");
        put_number(bytes, static_cast<uint32_t>(size));
        uint32_t state = number;
        for (size_t place = 0; place < size; ++place) {
            state = state * 1664525 + 1013904223;
            bytes.push_back(static_cast<uint8_t>(state >> 24));
        }
    }
    align(bytes);
    return bytes;
}

int main(int count, char **words) {
    if (count < 7) return 2;
    const std::string topic = words[1], kind = words[2];
    const uint32_t messages = static_cast<uint32_t>(std::stoul(words[3]));
    const double hertz = std::stod(words[4]);
    const size_t size = std::stoul(words[5]);
    const bool best_effort = count > 7 && std::strcmp(words[7], "best_effort") == 0;
    const std::string name =
        kind == "string" ? "std_msgs::msg::dds_::String_" : "sensor_msgs::msg::dds_::CompressedImage_";

    auto *participant = fast::DomainParticipantFactory::get_instance()->create_participant(0, fast::PARTICIPANT_QOS_DEFAULT);
    if (participant == nullptr) return 1;
    fast::TypeSupport type(new Raw(name, static_cast<uint32_t>(size + 256)));
    type.register_type(participant);
    auto *made = participant->create_topic("rt" + topic, name, fast::TOPIC_QOS_DEFAULT);
    auto *publisher = participant->create_publisher(fast::PUBLISHER_QOS_DEFAULT);
    fast::DataWriterQos qos = fast::DATAWRITER_QOS_DEFAULT;
    qos.reliability().kind = best_effort ? fast::BEST_EFFORT_RELIABILITY_QOS : fast::RELIABLE_RELIABILITY_QOS;
    qos.durability().kind = fast::VOLATILE_DURABILITY_QOS;
    qos.history().kind = fast::KEEP_LAST_HISTORY_QOS;
    qos.history().depth = kind == "string" ? 10000 : 20;
    qos.resource_limits().max_samples = 0;
    qos.resource_limits().max_samples_per_instance = 0;
    qos.resource_limits().max_instances = 0;
    qos.publish_mode().kind = fast::ASYNCHRONOUS_PUBLISH_MODE;
    auto *writer = publisher->create_datawriter(made, qos);
    if (writer == nullptr) return 1;

    std::printf("{\"ready\": true}\n");
    std::fflush(stdout);
    fast::PublicationMatchedStatus matched;
    do {
        std::this_thread::sleep_for(std::chrono::milliseconds(10));
        writer->get_publication_matched_status(matched);
    } while (matched.current_count == 0);
    // The other side has to have found this one, too.
    std::this_thread::sleep_for(std::chrono::seconds(2));

    FILE *copy = std::fopen(words[6], "wb");
    if (copy == nullptr) return 1;
    const auto begin = std::chrono::steady_clock::now();
    for (uint32_t number = 1; number <= messages; ++number) {
        Bytes bytes = message(kind, number, size);
        std::this_thread::sleep_until(begin + std::chrono::duration<double>((number - 1) / hertz));
        if (!writer->write(&bytes) || std::fwrite(bytes.data(), 1, bytes.size(), copy) != bytes.size()) return 1;
    }
    std::fclose(copy);
    std::printf("{\"sent\": %u, \"sha256\": null}\n", messages);
    std::fflush(stdout);
    std::this_thread::sleep_for(std::chrono::hours(1));
}
