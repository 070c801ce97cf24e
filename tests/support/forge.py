"""Plays publishers for the tests, by ROS's own library and by raw XML-RPC calls.

publish NAME TOPIC TEXT HZ   a node of exactly this name that publishes std_msgs/String
uri NAME                     prints the URI that the master has for a node
publishers TOPIC             prints the names of the nodes that publish it
register NAME TOPIC URI      registers a publisher of std_msgs/String at the master, whether or not it is there
announce TOPIC URI           tells every subscriber of TOPIC that URI is its publisher, without being the master
"""

import os
import sys
import xmlrpc.client


def master():
    return xmlrpc.client.ServerProxy(os.environ["ROS_MASTER_URI"])


def uri(name):
    code, _, found = master().lookupNode("/test", name)
    return found if code == 1 else ""


def publish(name, topic, text, hz):
    import rospy
    from std_msgs.msg import String

    rospy.init_node(name, anonymous=False, disable_rosout=True)
    publisher = rospy.Publisher(topic, String, queue_size=100)
    rate = rospy.Rate(float(hz))
    print("publishing", flush=True)
    while not rospy.is_shutdown():
        publisher.publish(text)
        rate.sleep()


def publishers(topic):
    _, _, (publishers, _, _) = master().getSystemState("/test")
    return " ".join(name for published, names in publishers if published == topic for name in names)


def announce(topic, publisher):
    _, _, (_, subscribers, _) = master().getSystemState("/test")
    for name in {name for subscribed, names in subscribers if subscribed == topic for name in names}:
        print(name, xmlrpc.client.ServerProxy(uri(name)).publisherUpdate("/master", topic, [publisher]))


def register(name, topic, publisher):
    print(master().registerPublisher(name, topic, "std_msgs/String", publisher))


if __name__ == "__main__":
    command, arguments = sys.argv[1], sys.argv[2:]
    if command == "uri":
        print(uri(*arguments), end="")
    elif command == "publishers":
        print(publishers(*arguments), end="")
    else:
        {"publish": publish, "announce": announce, "register": register}[command](*arguments)
