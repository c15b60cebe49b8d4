# SPDX-License-Identifier: Apache-2.0
"""Messages between the nodes of one process, handed over as bytes without the middleware.

ROS 2 has this for C++ nodes only. Here each publisher puts its bytes into an inbox of every
subscription of the same process, and the executor calls the subscriptions after the publisher's
callback has returned. The middleware gets a copy only while a subscription elsewhere matches, and
still delivers what publishers elsewhere send. It must not match endpoints of the same process, or
everything would arrive twice: see `middleware.share_process`.

Quality of service is that of the wire: only compatible endpoints meet, an inbox holds as many
messages as the history of its subscription, and a latched message reaches subscriptions that come
later. The order of the messages is that in which they were published.
"""
