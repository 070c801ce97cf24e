#!/bin/sh
# boot.sh ROOT PROGRAM: boots the machine whose disk is ROOT, with systemd as its first process and PROGRAM's folder as
# /opt/authros. It has namespaces of its own for mounts, processes, the host's name and groups (unshare -mpfuiC), the
# programs of the system it runs on, read-only, and that system's network. What is below /run, /tmp and /dev is new at each boot.
set -e
root=$1
mount --make-rprivate /
mount --bind "$root" "$root"
cd "$root"
mount --rbind /usr usr
mount -o remount,bind,ro usr
mount --bind "$(dirname "$2")" opt/authros
mount -o remount,bind,ro opt/authros
mount -t proc proc proc
mount --bind proc/sys proc/sys
mount -o remount,bind,ro proc/sys
mount -t sysfs -o ro sysfs sys
if [ -e /sys/fs/cgroup/cgroup.controllers ]; then
  mount -t cgroup2 cgroup sys/fs/cgroup
else
  mount -t tmpfs -o mode=755 tmpfs sys/fs/cgroup
  mkdir sys/fs/cgroup/systemd
  mount -t cgroup -o none,name=systemd cgroup sys/fs/cgroup/systemd
fi
mount -t tmpfs -o mode=755 tmpfs run
mount -t tmpfs -o mode=1777 tmpfs tmp
mount -t tmpfs -o mode=755 tmpfs dev
for name in null zero full random urandom tty; do
  : > "dev/$name"
  mount --bind "/dev/$name" "dev/$name"
done
mkdir dev/shm dev/pts
mount -t devpts -o newinstance,ptmxmode=0666 devpts dev/pts
ln -s pts/ptmx dev/ptmx
ln -s /proc/self/fd dev/fd
# What systemd says.
mkfifo dev/kmsg
cat dev/kmsg >> var/log/systemd.log &
pivot_root . mnt
umount -l /mnt
# Credentials are mounted by a child of systemd.
mount --make-rshared /
exec env -i container=authros PATH=/usr/bin:/usr/sbin SYSTEMD_UNIT_PATH=/etc/systemd/system SYSTEMD_GENERATOR_PATH= \
  /usr/lib/systemd/systemd --system --unit=multi-user.target --log-target=kmsg --show-status=no
