function [out, line, head] = delayed(line, head, begin, in, seconds, h)
% Takes `in` into a delay line and returns the one `seconds` ago, linear between steps of h seconds.
n = numel(line);
head = mod(head, n) + 1;
if begin
    line(:) = in;
end
line(head) = in;
position = min(max(seconds / h, 0), n - 2);
whole = floor(position);
part = position - whole;
out = (1 - part) * line(mod(head - whole - 1, n) + 1) + part * line(mod(head - whole - 2, n) + 1);
end
