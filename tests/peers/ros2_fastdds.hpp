// What the Fast DDS peers share: messages that are serialised already, as rmw_fastrtps has them, and how to serialise them.

#pragma once

#include <cstdint>
#include <cstring>
#include <functional>
#include <string>
#include <vector>

#include <fastdds/dds/topic/TopicDataType.hpp>

namespace fast = eprosima::fastdds::dds;
namespace rtps = eprosima::fastrtps::rtps;
using Bytes = std::vector<uint8_t>;

class Raw : public fast::TopicDataType {
public:
    Raw(const std::string &name, uint32_t longest) {
        setName(name.c_str());
        m_typeSize = longest;
        m_isGetKeyDefined = false;
    }
    bool serialize(void *data, rtps::SerializedPayload_t *payload) override {
        const Bytes &bytes = *static_cast<Bytes *>(data);
        std::memcpy(payload->data, bytes.data(), bytes.size());
        payload->length = static_cast<uint32_t>(bytes.size());
        payload->encapsulation = CDR_LE;
        return true;
    }
    bool deserialize(rtps::SerializedPayload_t *payload, void *data) override {
        static_cast<Bytes *>(data)->assign(payload->data, payload->data + payload->length);
        return true;
    }
    std::function<uint32_t()> getSerializedSizeProvider(void *data) override {
        return [data] { return static_cast<uint32_t>(static_cast<Bytes *>(data)->size()); };
    }
    void *createData() override { return new Bytes; }
    void deleteData(void *data) override { delete static_cast<Bytes *>(data); }
    bool getKey(void *, rtps::InstanceHandle_t *, bool) override { return false; }
};

inline void align(Bytes &bytes) {
    while (bytes.size() % 4 != 0) bytes.push_back(0);
}

inline void put_number(Bytes &bytes, uint32_t number) {
    align(bytes);
    for (int shift = 0; shift < 32; shift += 8) bytes.push_back(static_cast<uint8_t>(number >> shift));
}

inline void put_text(Bytes &bytes, const std::string &text) {
    put_number(bytes, static_cast<uint32_t>(text.size() + 1));
    bytes.insert(bytes.end(), text.begin(), text.end());
    bytes.push_back(0);
}
